"""The way back from the numbers of a loop to the entries of a study file."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import memsgyro_jax as mg
from memsgyro_jax.app.study.numbers import unit_at
from memsgyro_jax.base.errors import InputError
from memsgyro_jax.tuning.tunable import placed


LYAPUNOV = {
    "readout": {"kind": "velocity", "scale": "5 V*s/m"},
    "observer": {"kind": "lyapunov"},
    "controller": {
        "kind": "reference_model", "frequency": ["3 kHz", "5 kHz"],
        "energy": {"frequency": ["3 kHz", "5 kHz"], "amplitude": ["1 um", "0.5 um"], "gain": "9425 1/s"},
    },
    "filter": {"kind": "bandpass", "low": "1 Hz", "high": "20 Hz"},
}  # fmt: skip
FADING = {
    "observer": {
        "kind": "ekf", "fading": {"kind": "fixed", "forgetting": "10 1/s"}, "annealing": {"excess": 10},
        "process_noise": {"rate": "1 rad^2/s^3"},
    },
}  # fmt: skip
CLASSIC = {"controller": {"kind": "classic", "sense": "rebalanced", "amplitude": "1 um"}, "observer": {"kind": "none"}}
WHOLE_ANGLE = {
    "controller": {
        "kind": "whole_angle", "frequency": "3.2 kHz", "tones": [{"frequency": "500 Hz", "amplitude": "40 m/s^2"}],
        "rocking": {"frequency": "120 Hz", "amplitude": "1.2024 rad"},
    },
}  # fmt: skip
PATHS = {
    "jump": ({"observer": {"kind": "ekf", "jump": {"damping": "10 1/s", "window": "2 ms", "level": 4}}},
             ("observer.inner.noise_density.1", "observer.inner.process_noise.theta.0", "observer.window",
              "observer.level")),
    "whole angle": (WHOLE_ANGLE, ("controller.frequency", "controller.rocking.amplitude", "controller.rocking.phase",
                                  "controller.tones.1.0.amplitude")),
    "classic": (CLASSIC, ("controller.drive.phase_gain", "controller.drive.demodulator.bandwidth",
                          "controller.sense.integral", "controller.rate_offset")),
    "kalman": (FADING, ("observer.noise_density.1", "observer.process_noise.theta.0", "observer.process_noise.theta.3",
                        "observer.process_noise.offset.0", "observer.process_noise.motion.1",
                        "observer.process_noise.motion.2", "observer.fading.forgetting", "observer.annealing.excess",
                        "observer.annealing.decay", "controller.tones.1.0.amplitude", "controller.tones.0.0.phase",
                        "device.kxx", "readout.opamp_offset.0")),
    "lyapunov": (LYAPUNOV, ("observer.gain.0", "observer.adaptation.5", "filter.low", "filter.high", "controller.gain",
                            "controller.amplitude.1")),
}  # fmt: skip


def study_of(changes):
    return mg.default_study().changed(changes)


@pytest.mark.parametrize("name", PATHS)
def test_a_written_study_has_the_numbers_of_the_loop(name, tmp_path):
    changes, paths = PATHS[name]
    study = study_of(changes)
    at = [_at(study.loop, path) for path in paths]
    moved = placed(study.loop, paths, [jnp.asarray(1.01 * float(value) + 1e-12) for value in at])
    again = mg.load_study(study.with_numbers(moved, paths).write(tmp_path / "tuned.toml"))
    if "device.kxx" in paths:  # the observer was made for the old device
        moved = eqx.tree_at(lambda loop: loop.observer.prior, moved, again.loop.observer.prior)
    for path in paths:
        assert float(_at(again.loop, path)) == float(_at(moved, path)), path
    pairs = zip(jax.tree.leaves(again.loop), jax.tree.leaves(moved), strict=True)
    assert all(np.array_equal(np.asarray(a), np.asarray(b)) for a, b in pairs)


def _at(loop, path):
    here = loop
    for part in path.split("."):
        here = here[int(part)] if part.isdigit() else getattr(here, part)
    return here


def test_units():
    study = study_of(FADING)
    names = study.loop.device.model.names
    units = {
        "observer.noise_density": "V/sqrt(Hz)", "observer.process_noise.rate": "rad^2/s^3",
        "observer.process_noise.theta.kxx": "1/s^5", "controller.tones.0.0.frequency": "Hz", "observer.nothing": None,
    }  # fmt: skip
    assert {path: unit_at(study.file, names, path) for path in units} == units
    assert unit_at(study_of(CLASSIC).file, names, "controller.drive.force_integral") == "N/(m*s)"


def test_a_number_that_a_file_does_not_hold_is_told():
    study = mg.default_study()
    with pytest.raises(InputError, match=r"holds no entry for `observer.prior.theta_std.0`"):
        study.with_numbers(study.loop, ("observer.prior.theta_std.0",))


def test_adaptation_needs_a_gain_for_each_coefficient():
    with pytest.raises(InputError, match="adaptation must have one entry for each of rate, kxx"):
        study_of({**LYAPUNOV, "observer": {"kind": "lyapunov", "adaptation": [1.0, 2.0]}})


def test_the_swing_of_a_temperature_is_no_temperature(tmp_path):
    def loaded(amplitude):
        swing = f'{{ kind = "sine", amplitude = "{amplitude}", frequency = "1 Hz" }}'
        (tmp_path / "s.toml").write_text(f'[scenario]\ntemperature = ["25 degC", {swing}]')
        return mg.load_study(tmp_path / "s.toml").scenario.at(0.25).temperature

    assert loaded("5 K") == pytest.approx(303.15)
    assert loaded("5 delta_degC") == pytest.approx(303.15)
    with pytest.raises(mg.InputError, match=r"`scenario\.temperature\.1\.amplitude`: must be a difference"):
        loaded("5 degC")
