"""Sweeps of resonances that outlast their steps: what their phase tells, and what it does not."""

from types import SimpleNamespace

import numpy as np
import pytest

import memsgyro_jax as mg
from memsgyro_jax.measurement.case.unknown import _both_left_alone


TURN, DWELL = 2.0 * np.pi, 5.0
HERTZ = np.arange(1599.5, 1600.95, 0.01)


def rotating(frequency, quality):
    """(n,) phasor of the displacement of one mode at the end of each step, whose envelope is followed exactly."""
    z, decay, out = 0.0j, np.pi * frequency / quality, []
    for hertz in HERTZ:
        rate = -decay + 2j * np.pi * (frequency - hertz)
        steady = 1j * decay / rate  # unity at resonance, a quarter of a turn behind
        z = steady + (z - steady) * np.exp(rate * DWELL)
        out.append(z)
    return np.array(out)


def sweep(path, axis, sign=1.0):
    """Both channels in volts, of two modes that are turned a little beside them."""
    rng, first, second = np.random.default_rng(axis), rotating(1600.0, 300e3), rotating(1600.4, 260e3)
    shape = np.array([[np.cos(0.12), np.sin(0.12)], [-np.sin(0.12), np.cos(0.12)]])
    z = sign * (first[:, None] * shape[0] * shape[0, axis] + second[:, None] * shape[1] * shape[1, axis])
    z += 1e-4 * (rng.normal(size=z.shape) + 1j * rng.normal(size=z.shape))
    time = DWELL * (1 + np.arange(HERTZ.size))
    columns = np.column_stack([time, HERTZ, z[:, 0].real, z[:, 0].imag, z[:, 1].real, z[:, 1].imag])
    head = "t [s],f [Hz],X1 [V],Y1 [V],X2 [V],Y2 [V]"
    np.savetxt(path, columns, "%.9g", ",", header=head, comments="")
    return path


def test_the_phase_of_a_sweep_that_never_settles_does_not_tell_what_is_read(tmp_path):
    files = [sweep(tmp_path / f"drive_{name}.csv", axis) for axis, name in enumerate("xy")]
    found = mg.import_case(files, tmp_path / "case", drive=["1 V"])
    assert found.case.readout.order == 0
    assert "too fast for its phase to tell" in str(found)
    assert "at resonance its phase" not in str(found)


def test_readings_against_their_drive_have_resonances(tmp_path):
    """Of a pick-off that is turned round a mass below zero is told, of which a decay made a traceback."""
    files = [sweep(tmp_path / f"drive_{name}.csv", axis, sign=-1.0) for axis, name in enumerate("xy")]
    case = mg.import_case(files, tmp_path / "case", drive=["1 V"]).case
    assert case.design["mass"].value < 0.0
    low, high = case.resonances
    assert low < 2.0 * np.pi * 1600.0 < high
    assert 0.0 < case.shortest_decay < 60.0
    assert case.largest_quality > 0.0


def test_each_axis_is_told_by_the_decay_in_which_it_is_loud():
    """The other channel, in which both modes beat, has no decay of its own."""
    x, y, beat = (1.0, TURN * 1600.0, 0.017), (0.9, TURN * 1600.4, 0.019), (0.12, TURN * 1600.2, -0.5)
    heard = [SimpleNamespace(noise_level=2e-4, free_modes=lambda case, m=m: m) for m in ([x, beat], [beat, y])]
    found = _both_left_alone(SimpleNamespace(records=heard))
    np.testing.assert_allclose(np.sqrt(found.stiffness[:2]) / TURN, [1600.0, 1600.4])
    np.testing.assert_allclose(found.damping[:2], [0.034, 0.038])
    assert _both_left_alone(SimpleNamespace(records=heard[:1])) is None


@pytest.mark.slow
def test_decays_of_two_axes_tell_a_mode_each(tmp_path):
    """0.4 Hz apart, of which the other channel of each decay shows both: no record showed "a clear resonance"."""
    shape, time = np.array([[np.cos(0.12), np.sin(0.12)], [-np.sin(0.12), np.cos(0.12)]]), np.arange(0.0, 150.0, 0.1)
    poles = [-np.pi * f / q + 2j * np.pi * (f - 1600.2) for f, q in ((1600.0, 300e3), (1600.4, 260e3))]
    files = []
    for axis, name in enumerate("xy"):
        rng = np.random.default_rng(axis)
        z = sum(np.exp(p * time)[:, None] * s * s[axis] for p, s in zip(poles, shape, strict=True))
        z = z + 2e-4 * (rng.normal(size=z.shape) + 1j * rng.normal(size=z.shape))
        columns = np.column_stack([time, z[:, 0].real, z[:, 0].imag, z[:, 1].real, z[:, 1].imag])
        files.append(tmp_path / f"ringdown_{name}.csv")
        np.savetxt(files[-1], columns, "%.9g", ",", header="t [s],X1 [V],Y1 [V],X2 [V],Y2 [V]", comments="")
    case = mg.import_case(files, tmp_path / "case", reference="1600.2 Hz").case
    for key, hertz in (("kxx", 1600.0), ("kyy", 1600.4)):
        told = np.sqrt(case.design[key].value / case.design["mass"].value) / (2.0 * np.pi)
        assert abs(told - hertz) < 0.02
