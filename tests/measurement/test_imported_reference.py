"""The reference frequency of a lock-in, as attributes of a file say it."""

import h5py
import numpy as np
import pytest
from scipy.io import savemat

import memsgyro_jax as mg


TIME = np.arange(400) * 1e-3
Z = np.exp((-6.0 + 2j * np.pi * 3.0) * TIME) + 1e-4 * np.random.default_rng(1).normal(size=(2, 400)).T @ [1, 1j]


def stored(path, attributes=(), of_column=(), scalar=None):
    """A ringing of phasors, attributes of its group and of a column, and a scalar beside it."""
    with h5py.File(path, "w") as file:
        group = file.create_group("run")
        for name, values, unit in (("t", TIME, "s"), ("I", Z.real, "V"), ("Q", Z.imag, "V")):
            group[name] = values
            group[name].attrs["unit"] = unit
        group.attrs.update(dict(attributes))
        group["I"].attrs.update(dict(of_column))
        if scalar:
            group["oscillator_frequency"] = scalar[0]
            group["oscillator_frequency"].attrs["units"] = scalar[1]
    return path


@pytest.mark.parametrize(
    ("where", "name"),
    [
        ({"attributes": {"reference frequency (Hz)": 14300.0}}, "reference frequency (Hz)"),
        ({"attributes": {"ref_freq_kHz": 14.3}}, "ref_freq_kHz"),
        ({"attributes": {"referenceFrequency": "14.3 kHz"}}, "referenceFrequency"),
        ({"attributes": {"reference_frequency": 14300.0, "unit": "Hz"}}, "reference_frequency"),
        ({"attributes": {"reference_frequency": 14.3, "reference_frequency_unit": "kHz"}}, "reference_frequency"),
        ({"of_column": {"frequency of the reference [Hz]": 14300.0}}, "frequency of the reference [Hz]"),
        ({"scalar": (14.3, "kHz")}, "oscillator_frequency"),
        (
            {"attributes": {"reference frequency (Hz)": 14300.0, "oscillator frequency (Hz)": 1.0}},
            "reference frequency (Hz)",
        ),
    ],
)
def test_an_attribute_says_the_reference(where, name, tmp_path):
    found = mg.import_case([stored(tmp_path / "ringdown.h5", **where)], tmp_path / "case")
    (record,) = found.case.records
    assert record.reference_frequency == pytest.approx(2 * np.pi * 14300.0)
    assert f"as the file's attribute `{name}` says" in str(found)
    (given,) = mg.import_case([tmp_path / "ringdown.h5"], tmp_path / "given", reference="10 kHz").case.records
    assert given.reference_frequency == pytest.approx(2e4 * np.pi)


@pytest.mark.parametrize(
    "attributes",
    [
        {"reference clock frequency (Hz)": 1e7},
        {"reference frequency (V)": 14300.0},
        {"oscillator 1 frequency (Hz)": 14300.0, "oscillator 2 frequency (Hz)": 15000.0},
        {"reference frequency (Hz)": -1.0},
    ],
)
def test_what_is_not_clearly_the_reference_is_asked_for(attributes, tmp_path):
    with pytest.raises(mg.InputError, match="the reference frequency of the lock-in must be known, but no column"):
        mg.import_case([stored(tmp_path / "ringdown.h5", attributes)], tmp_path / "case")


def test_a_reference_without_a_unit_is_shown(tmp_path):
    with pytest.raises(mg.InputError, match=r"`reference_frequency` says 14300.0 without a unit.*--reference"):
        mg.import_case([stored(tmp_path / "a.h5", {"reference_frequency": 14300.0})], tmp_path / "case")


def test_a_number_of_a_structure_says_the_reference(tmp_path):
    content = {"t_s": TIME, "I_V": Z.real, "Q_V": Z.imag, "reference_frequency_Hz": 14300.0}
    savemat(tmp_path / "a.mat", {"run": content})
    (record,) = mg.import_case([tmp_path / "a.mat"], tmp_path / "case").case.records
    assert record.reference_frequency == pytest.approx(2 * np.pi * 14300.0)
