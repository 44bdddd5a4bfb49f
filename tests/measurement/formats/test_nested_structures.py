"""A frequency beside structures that hold the readings, as scripts save what demodulators gave."""

import h5py
import numpy as np
import pytest
from scipy.io import savemat
from two_channel_files import FREQUENCY, moved

import memsgyro_jax as mg


Z = moved("y")
DEMODULATORS = {f"demod{k + 1}": {"x": Z[:, k].real, "y": Z[:, k].imag} for k in (0, 1)}


def wrote(path, content):
    """A tree of names as MAT or HDF5 file."""
    if path.suffix == ".mat":
        savemat(path, content)
        return path

    def put(group, entries):
        for name, entry in entries.items():
            if isinstance(entry, dict):
                put(group.create_group(name), entry)
            else:
                group[name] = entry

    with h5py.File(path, "w") as file:
        put(file, content)
    return path


@pytest.mark.parametrize("ending", ["mat", "h5"])
@pytest.mark.parametrize(
    "content",
    [
        {"sweep": {"frequency": FREQUENCY, **DEMODULATORS, "drive_amplitude": 0.3}},
        {"frequency": FREQUENCY, "demods": DEMODULATORS},
        {"f_Hz": FREQUENCY, "x": {"I": Z[:, 0].real, "Q": Z[:, 0].imag}, "y": {"I": Z[:, 1].real, "Q": Z[:, 1].imag}},
    ],
)
def test_a_frequency_beside_structures_of_two_channels(content, ending, tmp_path):
    path = wrote(tmp_path / f"drive_y_300mV.{ending}", content)
    (record,) = mg.import_case([path], tmp_path / "case").case.records
    assert record.axis == 1
    np.testing.assert_allclose(record.phasors, Z, rtol=1e-12)


@pytest.mark.parametrize("place", ["sweep/", ""])
def test_a_map_names_columns_of_structures_by_their_places(place, tmp_path):
    path = wrote(tmp_path / "drive_y_300mV.mat", {"sweep": {"frequency": FREQUENCY, **DEMODULATORS}})
    said = f"f={place}frequency,x_I={place}demod2/x [Vrms],x_Q={place}demod2/y [Vrms]"
    (record,) = mg.import_case([path], tmp_path / "case", columns=said).case.records
    np.testing.assert_allclose(record.phasors[:, 0], 2**0.5 * Z[:, 1], rtol=1e-12)


def test_three_demodulators_are_named_with_a_map_to_copy(tmp_path):
    content = {"frequency": FREQUENCY, **DEMODULATORS, "demod3": DEMODULATORS["demod1"]}
    path = wrote(tmp_path / "drive_y.mat", content)
    with pytest.raises(mg.InputError, match=r"--map \"f=frequency,x_I=demod1/x,x_Q=demod1/y,y_I=demod2/x"):
        mg.import_case([path], tmp_path / "case")


def test_structures_of_other_names_are_records_of_their_own(tmp_path):
    content = {"frequency": FREQUENCY, "drive": np.full(FREQUENCY.size, 0.1)}
    content |= {name: {"X": z.real, "Y": z.imag} for name, z in (("up", Z[:, 0]), ("down", 2 * Z[:, 0]))}
    path = wrote(tmp_path / "run.mat", content)
    up, down = mg.import_case([path], tmp_path / "case").case.records
    assert (up.name, down.name) == ("run_up", "run_down")
    np.testing.assert_allclose(down.phasors[:, 0], 2 * Z[:, 0], rtol=1e-12)


def test_a_table_beside_structures_stays_as_it_is(tmp_path):
    own = {"frequency": FREQUENCY, "X": Z[:, 0].real, "Y": Z[:, 0].imag}
    path = wrote(tmp_path / "run.mat", {"sweep": {**own, "raw": {"x": Z[:, 1].real, "y": Z[:, 1].imag}}})
    (record,) = mg.import_case([path], tmp_path / "case").case.records
    np.testing.assert_allclose(record.phasors[:, 0], Z[:, 0], rtol=1e-12)
