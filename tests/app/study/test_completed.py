"""What a study leaves open follows its device; the ratios are those of the default study."""

import jax
import numpy as np
import pytest

import memsgyro_jax as mg
from memsgyro_jax.app.commands.options import chosen_study, with_unit


def device(low, high):
    """A device of 3 ug with modes at `low` and `high` [Hz], as text of a study file."""
    frequencies = f'frequency = ["{low} Hz", "{high} Hz"]\nquality_factor = 5000\nquadrature = "10 deg/s"\n'
    return f'[device]\nkind = "single_mass"\nmass = "3 ug"\n{frequencies}'


def loaded(tmp_path, text):
    (tmp_path / "study.toml").write_text(text)
    return mg.load_study(tmp_path / "study.toml")


def same_numbers(a, b):
    pairs = zip(jax.tree.leaves(a), jax.tree.leaves(b), strict=True)
    return all(np.array_equal(one, other) for one, other in pairs)


@pytest.mark.parametrize(("low", "high"), [(20e3, 20.1e3), (2.1e3, 4e3), (58e3, 59e3)])
def test_what_is_open_follows_the_device(tmp_path, low, high):
    study = loaded(tmp_path, device(low, high))
    (tone,), _ = study.loop.controller.tones
    np.testing.assert_allclose(mg.mode_frequencies(study.loop.device), (low, high), rtol=1e-12)
    assert float(tone.frequency) / low == pytest.approx(600 / 2893.09, rel=0.02)
    moved = float(tone.amplitude) / (2 * np.pi) ** 2 / (low**2 - float(tone.frequency) ** 2)
    assert moved == pytest.approx(0.1706e-6, rel=0.02), "a sixth of the start"
    assert study.settings.sample_rate == pytest.approx(26.6 * high, rel=0.05)
    assert study.settings.sample_rate * study.settings.duration == pytest.approx(10_000, rel=1e-12)
    assert float(study.loop.observer.annealing.decay) == pytest.approx(1.447 / low, rel=0.01)
    assert [float(v) for v in study.loop.start[:2]] == [1e-6, 0.0]
    (note,) = study.notes
    for words in ("follows the device", f"{study.settings.sample_rate:.3g} Hz", f"{float(tone.frequency):.4g} Hz"):
        assert words in note
    _, (note,) = chosen_study(tmp_path / "study.toml", None, None, dies=3, duration=with_unit("10 ms", "s"))
    assert "is sampled at" in note
    assert "runs" not in note, "an option of the command said it"
    again = mg.load_study(study.write(tmp_path / "again.toml"))
    assert again.file == study.file
    assert same_numbers(again.loop, study.loop)
    made = mg.Operation.of(study.loop.device)
    assert same_numbers(made.loop(), study.loop), "the same from Python"
    assert made.run == {name: getattr(study.settings, name) for name in ("sample_rate", "duration")}


def test_what_is_said_stays_and_the_rest_follows_it(tmp_path):
    said = '[sweep]\nsample_rate = "1 MHz"\n[loop]\ntravel = "5 um"\n[spread]\nrelative = "4 %"\n'
    study = loaded(tmp_path, device(20e3, 21e3) + said)
    assert study.settings.sample_rate == 1e6
    assert study.settings.duration == pytest.approx(376 / 21e3, rel=0.05)
    assert float(study.loop.start[0]) == float(study.loop.observer.prior.motion[0]) == 1e-7, "2 % of the travel"
    names, prior = study.loop.device.model.names, study.loop.observer.prior
    place = names.index("sigma")
    assert float(prior.theta_std[place] / prior.theta[place]) == pytest.approx(0.04), "as the dies vary"
    started = study.changed({"loop.displacement": ["3e-7 m", "0 m"], "device.frequency": ["18 kHz", "21 kHz"]})
    assert float(started.loop.observer.prior.motion[0]) == 3e-7
    (tone,), _ = started.loop.controller.tones
    (before,), _ = study.loop.controller.tones
    assert float(tone.frequency / before.frequency) == pytest.approx(0.9, rel=0.01), "a change moves what follows"
    assert study.changed({"controller.tones": []}).loop.controller.tones == ((), ())


def test_the_travel_is_that_of_the_combs():
    readout = mg.default_study().file.model_dump(by_alias=True, exclude_none=True)["readout"]
    study = mg.default_study().changed({"readout": {**readout, "overlap": ["30 um", "20 um"]}})
    assert float(study.loop.travel) == pytest.approx(20e-6)
    assert float(study.loop.start[0]) == 4e-7


DUAL = """[device]
kind = "dual_mass"
mass_x = "3 ug"
mass_y = "2 ug"
frequency = ["9 kHz", "10 kHz"]
quality_factor = [1000, 2000]
[spread.parameters]
"device.kyy" = { kind = "normal", std = "0.1 N/m" }
"""
READOUT = """[readout]
kind = "capacitive"
gradient = "5 nF/m"
capacitance = "50 fF"
capacitance_mismatch = "0.1 fF"
bias = "10 V"
feedback = "1 pF"
noise_density = "0.5 uV/sqrt(Hz)"
"""


def test_two_masses_by_their_modes_and_a_readout_by_its_capacitance(tmp_path):
    study = loaded(tmp_path, DUAL.replace("[spread", 'temperature = "27 degC"\n[spread') + READOUT)
    assert float(study.loop.device.temperature) == pytest.approx(300.15)
    assert float(study.loop.observer.process_noise.acceleration[0]) > 0.0, "the filter knows the Brownian force"
    np.testing.assert_allclose(mg.mode_frequencies(study.loop.device), (9e3, 10e3), rtol=1e-12)
    assert float(study.loop.device.dyy) == pytest.approx(2e-9 * 2 * np.pi * 10e3 / 2000)
    assert study.spread.items[0].distribution.std == 0.1
    readout = study.loop.readout
    np.testing.assert_allclose(readout.scale, -2 * 10.0 / 1e-12 * 5e-9)
    np.testing.assert_allclose(readout.offset, 1e-16 * 10.0 / 1e-12)
    assert float(study.loop.travel) == pytest.approx(10e-6), "until the capacitance is gone"
    assert mg.load_study(study.write(tmp_path / "again.toml")).file == study.file
    with pytest.raises(mg.InputError, match=r"holds no entry for `device.kxx`"):
        study.with_numbers(study.loop, ("device.kxx",))


CARRIER = """[readout]
kind = "carrier"
gradient = "5 nF/m"
capacitance = "200 fF"
capacitance_mismatch = "0.4 fF"
carrier = "1 V"
carrier_frequency = "1 MHz"
frequency = "9 kHz"
bandwidth = "100 kHz"
feedback = "0.2 pF"
parasitic = "12 pF"
gain_bandwidth = "200 MHz"
resistor = "50 Mohm"
opamp_noise = "5 nV/sqrt(Hz)"
opamp_corner = "10 kHz"
temperature = "300 K"
"""


def test_a_readout_by_its_carrier(tmp_path):
    study = loaded(tmp_path, DUAL + CARRIER)
    readout = study.loop.readout
    assert float(readout.scale[0]) == pytest.approx(-2.0 * 5e-9 / 0.2e-12, rel=0.15), "the op-amp loses some of it"
    assert float(readout.noise_density[0]) > 5e-9 * 12.0 / 0.2, "its noise counts by the parasitics"
    assert mg.load_study(study.write(tmp_path / "again.toml")).file == study.file


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('"9 kHz"', '"9 N/m"', ["line 5, `device.frequency", '"Hz"', '"N/m"']),
        ('["9 kHz", "10 kHz"]', '["9 kHz"]', ["line 5, `device.frequency`: must have at least 2 entries, but has 1"]),
        ('"9 kHz"', '"9 kHz", "1 Hz"', ["line 5, `device.frequency`: must have at most 2 entries, but has 3"]),
        ("[1000, 2000]", "[1000, 0]", ["line 6, `device.quality_factor", "greater than 0"]),
        ("[1000, 2000]", "[1000, 2000]\nquadrature = 3", ["line 7, `device.quadrature`", "must carry a unit"]),
        ("[1000, 2000]", '[1000, 2000]\nquadrature = "1 MHz"', ["line 7", '"rad/s"']),
        ("[1000, 2000]", '[1000, 2000]\nquadrature = "1e6 deg/s"', ["`device`", "`quadrature` must be smaller"]),
        ("[1000, 2000]", '[1000, 2000]\nkxx = "3 N/m"', ["line 7, `device.kxx`", "is not known"]),
        ("quality_factor = [1000, 2000]", "", ["`device.quality_factor`", "is missing"]),
        ("[1000, 2000]", '[1000, 2000]\ntemperature = "-300 degC"', ["line 7, `device.temperature", "0"]),
        ("10 V", "10 m", ["`readout.bias`", '"V"', '"m"']),
        ("5 nF/m", "0 nF/m", ["`readout.gradient", "greater than 0"]),
        ('"0.5 uV/sqrt(Hz)"', '"0.5 uV/sqrt(Hz)"\nsnr = { ratio = 100 }', ["`readout`", "either noise_density or snr"]),
    ],
)
def test_what_no_device_has_is_told_with_its_place(tmp_path, old, new, words):
    assert (DUAL + READOUT).count(old) == 1
    with pytest.raises(mg.InputError) as error:
        loaded(tmp_path, (DUAL + READOUT).replace(old, new))
    for word in words:
        assert word in str(error.value), str(error.value)
