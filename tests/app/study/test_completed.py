"""What a study leaves open follows its device; the ratios are those of the default study."""

import jax
import numpy as np
import pytest

import memsgyro_jax as mg


def device(low, high):
    """A device of 3 ug with modes near `low` and `high` [Hz], as text of a study file."""
    mass, q = 3e-9, 5e3
    (kx, dx), (ky, dy) = ((mass * (w := 2 * np.pi * f) ** 2, mass * w / q) for f in (low, high))
    return (
        f'[device]\nkind = "single_mass"\nmass = "{mass} kg"\nkxx = "{kx} N/m"\nkyy = "{ky} N/m"\n'
        f'kxy = "{1e-4 * kx} N/m"\ndxx = "{dx} N*s/m"\ndyy = "{dy} N*s/m"\ndxy = "{0.02 * dx} N*s/m"\n'
    )


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
    started = study.changed({"loop.displacement": ["3e-7 m", "0 m"], "device.mass": "3.6e-9 kg"})
    assert float(started.loop.observer.prior.motion[0]) == 3e-7
    (tone,), _ = started.loop.controller.tones
    (before,), _ = study.loop.controller.tones
    assert float(tone.frequency / before.frequency) == pytest.approx(1.2**-0.5, rel=0.01), "a change moves what follows"
    assert study.changed({"controller.tones": []}).loop.controller.tones == ((), ())


def test_the_travel_is_that_of_the_combs():
    readout = mg.default_study().file.model_dump(by_alias=True, exclude_none=True)["readout"]
    study = mg.default_study().changed({"readout": {**readout, "overlap": ["30 um", "20 um"]}})
    assert float(study.loop.travel) == pytest.approx(20e-6)
    assert float(study.loop.start[0]) == 4e-7
