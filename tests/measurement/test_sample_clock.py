"""Readings without a column of time: the rate that a file or the user tells makes one."""

import h5py
import numpy as np
import pytest
from scipy.io import savemat

from memsgyro_jax.base.errors import InputError
from memsgyro_jax.measurement.formats.steady_step import step_of_samples
from memsgyro_jax.measurement.import_case import import_case


RATE, ROWS = 50e3, 4000


def ringing(axes: int = 1) -> np.ndarray:
    time = np.arange(ROWS) / RATE
    envelope = np.exp(-time / 0.02)[:, None] * [0.3, 0.2][:axes]
    return envelope * np.sin(2 * np.pi * np.multiply.outer(time, [6e3, 6.4e3][:axes])) + 1e-3 * np.random.default_rng(
        0
    ).normal(size=(ROWS, axes))


def clock(folder) -> np.ndarray:
    (file,) = folder.glob("*.csv")
    return np.loadtxt(file, delimiter=",", skiprows=1)[:, 0]


@pytest.mark.parametrize(
    ("attributes", "step"),
    [
        ({"fs_Hz": "50000"}, 2e-5),
        ({"SampleRate": "50 kHz"}, 2e-5),
        ({"Sampling rate (kHz)": "50,0"}, 2e-5),
        ({"dt": "2e-5"}, 2e-5),
        ({"acq/Sample Interval": "20 us"}, 2e-5),
        ({"xIncrement": "0.02", "xIncrement_unit": "ms"}, 2e-5),
        ({"sample rate": "2e-5 s"}, 2e-5),
        ({"fs": "-1"}, 0.0),
        ({"fs": "3 V"}, 0.0),
        ({"offset": "5"}, 0.0),
    ],
)
def test_a_rate_or_a_step_is_told_in_many_words(attributes, step):
    assert step_of_samples(attributes)[0] == pytest.approx(step)


def test_a_matrix_with_names_and_a_rate_beside_it(tmp_path):
    """An HDF5 file of a data logger was refused, with a --map that took a signal for the time."""
    with h5py.File(tmp_path / "ring.h5", "w") as file:
        data = file.create_dataset("acq/channels", data=ringing(2))
        data.attrs.update({"fs_Hz": RATE, "names": ["Vx", "Vy"], "units": "V"})
    made = import_case([tmp_path / "ring.h5"], tmp_path / "case")
    assert made.case.channels == 2
    assert "in steps of 2e-05 s, as the file's attribute `fs_Hz` says" in str(made)
    np.testing.assert_allclose(clock(tmp_path / "case"), np.arange(ROWS) / RATE, rtol=0, atol=1e-12)


def test_one_signal_and_its_rate(tmp_path):
    savemat(tmp_path / "ring.mat", {"v": ringing()[:, 0], "fs": RATE})
    import_case([tmp_path / "ring.mat"], tmp_path / "case")
    np.testing.assert_allclose(clock(tmp_path / "case"), np.arange(ROWS) / RATE, rtol=0, atol=1e-12)


def test_the_rate_as_the_user_says(tmp_path):
    np.savetxt(tmp_path / "ring.csv", ringing(2), header="Vx [V],Vy [V]", delimiter=",", comments="")
    with pytest.raises(InputError, match="--sample-rate"):
        import_case([tmp_path / "ring.csv"], tmp_path / "case")
    import_case([tmp_path / "ring.csv"], tmp_path / "case", sample_rate="50 kHz")
    assert clock(tmp_path / "case")[-1] == pytest.approx((ROWS - 1) / RATE)
    timed = np.column_stack([np.arange(ROWS) / RATE, ringing()])
    np.savetxt(tmp_path / "timed.csv", timed, header="t [s],V [V]", delimiter=",", comments="")
    with pytest.raises(InputError, match=r"`t \[s\]` tells it"):
        import_case([tmp_path / "timed.csv"], tmp_path / "other", sample_rate="50 kHz")


def test_waveforms_named_like_parts_of_a_phasor_have_a_map_to_copy(tmp_path):
    with h5py.File(tmp_path / "ring.h5", "w") as file:
        data = file.create_dataset("channels", data=ringing(2))
        data.attrs.update({"sample_rate": RATE, "names": ["x", "y"], "units": ["V", "V"]})
    with pytest.raises(InputError, match="if these are waveforms of two axes") as said:
        import_case([tmp_path / "ring.h5"], tmp_path / "case")
    columns = str(said.value).split('--map "')[1].split('"')[0]
    assert import_case([tmp_path / "ring.h5"], tmp_path / "case", columns=columns).case.channels == 2


def test_the_level_of_the_drive_in_an_attribute_with_its_unit_beside_the_name(tmp_path):
    f = np.linspace(9.9e3, 10.1e3, 101)
    z = 1 / (1 - (f / 1e4) ** 2 + 1j * f / 1e4 / 500)
    text = [
        f"{a:.6f};{b:.8e};{c:.8e}".replace(".", ",") for a, b, c in zip(f, abs(z), np.degrees(np.angle(z)), strict=True)
    ]
    head = ["Messung;Frequenzgang", "Anregung (V);0,25", "Frequenz (Hz);Betrag (V);Phase (deg)"]
    (tmp_path / "sweep.csv").write_text("\n".join(head + text))
    assert "the drive is 0.25 V, as the file's attribute `Anregung (V)` says" in str(
        import_case([tmp_path / "sweep.csv"], tmp_path / "case")
    )
