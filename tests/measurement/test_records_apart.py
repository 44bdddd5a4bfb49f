"""Records that read too much, too little or elsewhere are named, and laws of the device are not taken for that."""

import numpy as np
import pytest

from memsgyro_jax.measurement.experiments.base import Phasors
from memsgyro_jax.measurement.records_apart import out_of_line


HERTZ = np.linspace(13390.0, 13410.0, 121)
LEVELS = {"s_5mV": 5e-3, "s_10mV": 1e-2, "s_20mV": 2e-2, "s_40mV": 4e-2}


def sweep(level, *, gain=1.0, resonance=13400.0, quality=6000.0, noise=2e-4, seed=0):
    """One over a resonance, in volts, of which a volt of drive makes ten at the peak of a quality factor of 6000."""
    rng, square, omega = np.random.default_rng(seed), (2 * np.pi * resonance) ** 2, 2 * np.pi * HERTZ
    z = gain * level * 10.0 / 6000.0 * square / (square - omega**2 + 1j * omega * np.sqrt(square) / quality)
    z = z + noise * (rng.normal(size=HERTZ.size) + 1j * rng.normal(size=HERTZ.size))
    return Phasors(omega, z[:, None], np.full((HERTZ.size, 1), level + 0j), np.full(HERTZ.size, 1 / noise))


def records(**odd):
    """Four drives, of which one is odd."""
    return [(name, sweep(u, seed=k, **odd.get(name, {}))) for k, (name, u) in enumerate(LEVELS.items())]


@pytest.mark.parametrize(
    ("odd", "said"),
    [
        ({"gain": 2**-0.5}, r"`s_20mV` reads 0.707"),
        ({"gain": 1e3, "noise": 0.2}, "as millivolts taken for volts"),
        ({"gain": 10.0}, r"`s_20mV` reads 10"),
        ({"resonance": 13403.0}, "`s_20mV` resonates at 13.403 kHz"),
    ],
)
def test_the_odd_record_is_named(odd, said):
    (sentence,) = out_of_line(records(s_20mV=odd))
    assert said in sentence
    assert "`s_5mV`, `s_10mV`, `s_40mV`" in sentence


def test_records_that_agree_are_not_named():
    assert out_of_line(records()) == []
    assert out_of_line(records(s_20mV={"gain": 1.1})) == [], "as levels are off by"


@pytest.mark.parametrize("seed", range(4))
def test_laws_of_the_device_are_no_contradiction(seed):
    """Damping that grows with the swing lowers the peak, and a spring that softens moves it: in the order of drives."""
    more = {
        name: {"quality": 6000.0 / (1 + 20.0 * u), "resonance": 13400.0 - 2500.0 * u**2} for name, u in LEVELS.items()
    }
    rows = [(name, sweep(u, seed=10 * seed + k, **more[name])) for k, (name, u) in enumerate(LEVELS.items())]
    assert out_of_line(rows) == []
    assert out_of_line([(name, row) for name, row in rows if name != "s_10mV"]) == []


def test_a_record_of_two_axes_is_compared_along_the_axis_that_is_driven():
    """Three sweeps of 0.1, 0.3 and 1 V, all declared 1 V, got no word where two channels were read."""
    told = []
    for k, (name, gain) in enumerate({"a": 0.1, "b": 0.3, "c": 1.0}.items()):
        one = sweep(0.01, gain=gain, noise=2e-5, seed=k)
        zero = np.zeros_like(one.force)
        told.append((name, one._replace(
            motion=np.hstack([one.motion, 0.02 * one.motion]), force=np.hstack([one.force, zero])
        )))  # fmt: skip
    other = sweep(0.01, resonance=13404.0, seed=5)
    told.append(("y", other._replace(
        motion=np.hstack([0.02 * other.motion, other.motion]), force=np.hstack([0 * other.force, other.force])
    )))  # fmt: skip
    said = out_of_line(told)
    assert len(said) == 2
    assert "`b` reads 3 times what `a` does" in said[0]
    assert "`c` reads 10 times what `a` does" in said[1]
