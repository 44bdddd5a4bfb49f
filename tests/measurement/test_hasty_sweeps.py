"""Sweeps of resonances that outlast their steps: what their phase tells, and what it does not."""

import numpy as np

import memsgyro_jax as mg


DWELL = 5.0
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
