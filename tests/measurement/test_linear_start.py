"""A start from the data alone lands near the device, whatever the design said."""

from dataclasses import replace

import numpy as np
import pytest
from bench_case import DIE, RESONATOR, bench, truth
from lab.die import Hidden
from lab.protocol import Laboratory, Multisine, Sweep
from lab.strengths import visible

from memsgyro_jax.measurement.experiments import Phasors
from memsgyro_jax.measurement.linear_start import design_device, starting_device
from memsgyro_jax.measurement.phasor_fit import device_of_phasors


SWEPT = Sweep("sweep", 0, (0.002, 0.006), points=15, span=25.0, dense=4.0, both=False, noise=1e-4)


def miss(found, true):
    """Errors of stiffness, damping (coupling entries against their own axes') and mobility, relative."""

    def against_axes(entries):
        entries = np.asarray(entries)
        return entries if entries.size == 1 else np.append(entries[:2], np.sqrt(entries[0] * entries[1]))

    pairs = [(getattr(found, name), getattr(true, name)) for name in ("stiffness", "damping")]
    parts = [np.abs(np.asarray(a) - np.asarray(b)) / against_axes(b) for a, b in pairs]
    return *(part.max() for part in parts), abs(float(found.mobility / true.mobility) - 1)


def only(case, *names):
    return replace(case, records=tuple(r for r in case.records if r.name in names))


@pytest.mark.parametrize(
    "hidden", [(), ("cubic_stiffness_x",), pytest.param(("readout_delay",), marks=pytest.mark.slow)]
)
def test_a_gyro_starts_from_its_sweeps(hidden):
    made = bench(visible(*hidden))
    true = truth(made.case, DIE, Hidden(), ()).device
    stiffness, damping, mobility = miss(starting_device(made.case), true)
    assert stiffness < 1e-4
    assert damping < 0.03
    assert mobility < 0.02
    assert max(miss(design_device(made.case), true)) > 0.04, "the design alone is no such start"


@pytest.mark.parametrize("name", ["sweep_x", "sweep_y"])
def test_one_driven_axis_is_enough(name):
    """The other axis moves too, by the coupling."""
    made = bench()
    stiffness, damping, mobility = miss(
        starting_device(only(made.case, name)), truth(made.case, DIE, Hidden(), ()).device
    )
    assert stiffness < 1e-3
    assert damping < 0.1
    assert mobility < 0.05


WEAK = (12100.0, 12400.0), (4000.0, 2500.0), 1.2e5, 0.5  # frequencies [Hz], Q, coupling [Hz²], step [Hz]
WEAKER = (21300.0, 21900.0), (8000.0, 3000.0), 2.0e5, 1.0  # the peak of y stands 20 standard deviations out


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize(("device", "close"), [(WEAK, (0.1, 1.0)), (WEAKER, (0.1, 1.5))])
def test_an_axis_that_hardly_moves_is_seen_at_its_own_resonance(device, close, seed):
    """Its readings at the resonance of the other axis are thousands of times larger than its noise, and say little of
    it: weighed like those of the driven axis they led to resonances up to 57 widths off. The weaker was put 200 Hz too
    low, with noise in the columns of the equation.
    """
    (first, second), (sharp, dull), coupling, step = device
    omega = 2.0 * np.pi * np.arange(first - 50.0, second + 50.1, step)
    stiffness = (2.0 * np.pi) ** 2 * np.array([[first**2, coupling], [coupling, second**2]])
    damping = 2.0 * np.pi * np.diag([first / sharp, second / dull])
    turn = 1j * omega[:, None, None]
    force = np.outer(np.full(omega.size, 0.02), [1.0, 0.0]) + 0j
    moved = np.linalg.solve(stiffness + turn**2 * np.eye(2) + turn * damping, 7.9e7 * force[..., None])[..., 0]
    noise, std = np.random.default_rng(seed).normal(size=(2, *moved.shape)), 3.5e-4 * np.abs(moved).max()
    read = moved + std * (noise[0] + 1j * noise[1])
    found = device_of_phasors([Phasors(omega, read, force, np.full(omega.size, 1 / std))])
    frequency = np.sqrt(np.asarray(found.stiffness)[:2]) / (2.0 * np.pi)
    assert np.all(np.abs(frequency - [first, second]) < close), frequency
    np.testing.assert_allclose(np.asarray(found.damping)[:2], np.diag(damping), rtol=0.2)
    assert float(found.stiffness[2]) == pytest.approx(stiffness[0, 1], rel=0.15)


@pytest.mark.parametrize("experiment", [Multisine("multisine", samples=1024), SWEPT])
def test_a_resonator_starts_from_any_of_its_records(experiment):
    made = bench(protocol=Laboratory((experiment,)), die=RESONATOR)
    stiffness, damping, mobility = miss(starting_device(made.case), truth(made.case, RESONATOR, Hidden(), ()).device)
    assert stiffness < 5e-4
    assert damping < 0.03
    assert mobility < 0.03


def test_the_design_does_not_matter():
    made = bench()
    wrong = {
        n: replace(v, value=2.0 * v.value, low=2.0 * v.low, high=2.0 * v.high) if n[0] == "d" else v
        for n, v in made.case.design.items()
    }
    one, other = starting_device(made.case), starting_device(replace(made.case, design=wrong))
    np.testing.assert_array_equal(one.damping, other.damping)


def test_validation_records_are_not_looked_at():
    made = bench()
    spoilt = [
        replace(r, role="validation", phasors=np.full_like(r.phasors, 1e3)) if r.name == "sweep_y" else r
        for r in made.case.records
    ]
    without = [r for r in made.case.records if r.name != "sweep_y"]
    one, other = (starting_device(replace(made.case, records=tuple(records))) for records in (spoilt, without))
    np.testing.assert_array_equal(one.stiffness, other.stiffness)


@pytest.mark.parametrize("name", ["ringdown", "rate", "raw"])
def test_where_the_records_do_not_hold_the_device_it_starts_at_the_design(name):
    """A ring-down offers no phasors, a table one frequency, 3 ms of a raw capture no resonance of 100 ms."""
    made = bench()
    found, design = starting_device(only(made.case, name)), design_device(made.case)
    np.testing.assert_array_equal(found.stiffness, design.stiffness)
    np.testing.assert_array_equal(found.damping, design.damping)
    assert float(found.mobility) == float(design.mobility) == 1 / made.case.design["mass"].value


def test_coupled_axes_are_told_as_well_as_the_noise_allows():
    """One drive's sweep of both channels, through both resonances: quality factors scattered by half as much again as
    the bound of Cramér and Rao, 1880 ± 40 for 1999 among them.
    """
    omega = 2 * np.pi * np.concatenate([centre + np.linspace(-40.0, 40.0, 61) for centre in (12000.0, 12300.0)])
    (x, y), noise = (2 * np.pi * np.array([12000.0, 12300.0])), 2e-12
    true = np.array([x**2, y**2, 0.004 * x**2, x / 2000.0, y / 1500.0, 0.1 * x / 2000.0, 1e7])
    force = np.outer(np.ones(omega.size), [1e-7, 0.0]) + 0j

    def motion(numbers):
        kxx, kyy, kxy, dxx, dyy, dxy, mobility = numbers
        turn = 1j * omega
        across = kxy + turn * dxy
        a, b = kxx + turn**2 + turn * dxx, kyy + turn**2 + turn * dyy
        return 1e-7 * mobility * np.stack([b, -across], axis=1) / (a * b - across**2)[:, None]

    moved = [(motion(true + step) - motion(true - step)).ravel() / 2e-6 / noise for step in np.diag(1e-6 * true)]
    slopes = np.concatenate([np.real(moved), np.imag(moved)], axis=1)
    least = np.sqrt(np.diag(np.linalg.inv(slopes @ slopes.T)))
    off, rng = [], np.random.default_rng(2)
    for _ in range(24):
        parts = noise * rng.standard_normal((2, omega.size, 2))
        seen = motion(true) + parts[0] + 1j * parts[1]
        found = device_of_phasors([Phasors(omega, seen, force, np.full(omega.size, 1.0 / noise))])
        numbers = np.concatenate([found.stiffness, found.damping, [found.mobility]])
        off.append((numbers / true - 1.0) / least)
    assert np.sqrt(np.mean(np.square(off))) < 1.15
    assert np.max(np.abs(np.mean(off, axis=0))) < 4.0 / np.sqrt(24)


@pytest.mark.parametrize(("shunt", "full"), [(14.0, np.inf), (20.0, 440.0), (np.inf, 440.0)])
def test_a_crystal_beside_its_shunt_and_a_converter_that_clips_bend_no_resonance_over(shunt, full):
    """Amplitudes of a tuning fork at 32.7585 kHz, in counts, with the antiresonance of its shunt so many hertz above: a
    resonance bent over by its own band fitted a little less badly, at 32.77 and 32.81 kHz, above all rows.
    """
    hertz = np.arange(32740.0, 32777.0, 0.2)
    away = hertz - 32758.5
    size = np.abs(1.0 - away / shunt) / np.abs(1.0 + 2j * 16000.0 * away / 32758.5)
    counts = np.clip(np.round(900.0 * size + 2.0), 1.0, full)
    omega, force = 2 * np.pi * hertz, np.ones((hertz.size, 1)) + 0j
    found = device_of_phasors([Phasors(omega, counts[:, None] + 0j, force, np.full(hertz.size, 0.2), True)])
    assert np.sqrt(float(found.stiffness[0])) / (2 * np.pi) == pytest.approx(32758.5, abs=1.0)
    assert 5000.0 < np.sqrt(float(found.stiffness[0])) / float(found.damping[0]) < 25000.0
