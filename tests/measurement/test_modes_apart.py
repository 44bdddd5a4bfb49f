"""The modes of two coupled axes, told apart by what both channels show of them."""

import numpy as np
import pytest

from memsgyro_jax.measurement.case import load_case
from memsgyro_jax.measurement.modes_apart import modes_apart
from memsgyro_jax.measurement.tracking import tracked


RATE, HERTZ, SLOW = 50e3, np.array([11204.4, 11252.1]), np.array([10.8, 16.1])
SHAPES = np.array([[1.0, 0.08], [-0.07, 0.5]])  # of each mode (in columns) in both channels
CASE = """
    schema = "memsgyro-case/1"
    name = "two"
    device = "single_mass"
    [readout]
    quantity = "displacement"
    [[experiment]]
    name = "both"
    kind = "free_decay"
    file = "both.csv"
    """


def ringing(seed, turn=0.0, lasts=0.6):
    """Both channels, of a mode of x whose frequency falls by so much [rad/s] while it dies out."""
    time = np.arange(int(lasts * RATE)) / RATE
    phase = np.outer(time, 2 * np.pi * HERTZ)
    phase[:, 0] += turn * -np.expm1(-2 * SLOW[0] * time) / (2 * SLOW[0])
    motion = np.exp(-np.outer(time, SLOW)) * np.sin(phase + np.array([0.0, 1.0]))
    return time, motion @ SHAPES.T + 1e-3 * np.random.default_rng(seed).standard_normal(motion.shape)


def told(time, signals):
    omega = 2 * np.pi * 11.2e3
    each = modes_apart(time, signals, 2 * np.pi * HERTZ[0], 27).T
    return sorted((tracked(time, one, (0.5 * omega, 2 * omega)) for one in each), key=lambda track: track.usual[0])


@pytest.mark.parametrize("seed", range(2))
def test_each_mode_falls_and_turns_at_its_own_rate(seed):
    for track, hertz, slow in zip(told(*ringing(seed)), HERTZ, SLOW, strict=True):
        omega, decay = track.usual
        assert omega / (2 * np.pi) == pytest.approx(hertz, rel=3e-5)
        assert decay == pytest.approx(slow, rel=5e-3)
        assert track.seen.turned(0.3) < 2.0


def test_a_frequency_that_falls_still_turns_its_mode():
    assert told(*ringing(0, turn=60.0))[0].seen.turned(0.3) == pytest.approx(60.0 * 0.3, rel=0.3)


@pytest.mark.parametrize("lasts", [0.3, 0.6])
def test_a_linear_decay_of_two_axes_is_read_in_its_halves(lasts, tmp_path):
    """Its channels turn, as in y what is left of x outlasts y: in pieces of 54 to 1071 rows of 30000 each lost a start,
    and a quality factor was told to 19 where it is to 0.4.
    """
    time, volts = ringing(1, lasts=lasts)
    table = np.column_stack([time, volts])
    np.savetxt(tmp_path / "both.csv", table, fmt="%.9g", delimiter=",", header="t [s],Vx [V],Vy [V]", comments="")
    (tmp_path / "case.toml").write_text(CASE)
    case = load_case(tmp_path)
    (record,) = case.records
    assert record.piece_rows(case) == record.rows // 2
