"""The missing force is the one that was left out: a cubic spring, taken from the model of the demonstration."""

from dataclasses import replace

import equinox as eqx
import numpy as np
import pytest
from bench_case import ONE_AXIS, RESONATOR, bench, demonstration
from lab.die import Hidden, Outside

from memsgyro_jax.diagnosis.fit import fit_case
from memsgyro_jax.diagnosis.residual_force import beside_lowest_drive, rate_residuals, sweep_forces, time_forces
from memsgyro_jax.effects import ParasiticMode
from memsgyro_jax.measurement.experiments.missing_force import in_bins, weight_above_noise


@pytest.fixture(scope="module")
def right():
    return demonstration()


@pytest.fixture(scope="module")
def strength(right):
    return float(right.model.effects[0].strength)


@pytest.fixture(scope="module")
def lacking(right):
    """The same device, read-out and offsets without the spring, not fitted again."""
    bare = eqx.tree_at(lambda m: m.effects, right.model, (), is_leaf=lambda x: isinstance(x, tuple))
    return fit_case(right.case, model=bare, held=True)


def test_a_sweep_shows_the_describing_function_of_the_spring(lacking, strength):
    """−s·x³ acts like a stiffness ¾·s·A² and like no damping, to the noise."""
    x, y = sweep_forces(lacking)
    assert (x.record, x.axis, y.axis) == ("sweep_x", 0, 1)
    stiffness = (x.stiffness[:, 0] - 0.75 * strength * x.amplitude**2) / x.stiffness_std[:, 0]
    damping = x.damping[:, 0] / x.damping_std[:, 0]
    other = x.force[:, 1] / x.std[:, 1]
    for normal in (stiffness, damping, other.real, other.imag):
        assert abs(np.mean(normal**2) - 1.0) < 4 * np.sqrt(2 / normal.size)
    assert np.max(np.abs(x.stiffness[:, 0] / x.stiffness_std[:, 0])) > 100, (
        "far above the noise where the motion is large"
    )


GAP, STOP = 0.05, 0.03 * RESONATOR.kxx


@pytest.mark.slow
def test_beside_the_lowest_drive_a_stop_shows_as_a_kink_at_its_gap():
    """Nothing before it, then the describing function of a one-sided stop, s/π·(α − sin α·cos α), cos α = gap/A; beside
    the model that is fitted to all drives neither.
    """
    hidden = Hidden(outside=Outside(stop_x=STOP, stop_gap=GAP))
    every = fit_case(bench(hidden, 1, ONE_AXIS, RESONATOR).case)
    lowest = beside_lowest_drive(every)
    for fit, shared_out in ((every, True), (lowest, False)):
        (found, _) = sweep_forces(fit)
        free = found.amplitude < GAP
        normal = found.stiffness[free, 0] / found.stiffness_std[free, 0]
        assert (np.mean(normal**2) > 10) == shared_out
    beyond = found.amplitude > 1.2 * GAP
    alpha = np.arccos(GAP / found.amplitude[beyond])
    stop = STOP / np.pi * (alpha - np.sin(alpha) * np.cos(alpha))
    np.testing.assert_allclose(
        found.stiffness[beyond, 0], stop, rtol=0.1, atol=4 * found.stiffness_std[beyond, 0].max()
    )
    assert np.max(stop / found.stiffness_std[beyond, 0]) > 50


def test_a_single_drive_is_its_own_reference(right):
    sweep = right.case.record("sweep_x")
    alone = sweep.sweeps[0]
    names = ("lines", "frequency", "drive", "temperature", "bias_voltage", "rate", "phasors")
    alone = replace(sweep, **{name: getattr(sweep, name)[alone] for name in names})
    fit = replace(right, case=replace(right.case, records=(alone,)))
    assert beside_lowest_drive(fit) is fit


def test_nothing_is_missing_from_the_right_model(right):
    for found in sweep_forces(right):
        normal = np.stack([found.force.real, found.force.imag]) / found.std
        assert abs(np.mean(normal**2) - 1.0) < 4 * np.sqrt(2 / normal.size)
    assert not any(found.force.any() for found in time_forces(right))


@pytest.mark.slow
def test_an_appendage_at_rest_follows(right):
    """An effect with a state of its own and hardly any mass changes nothing."""
    model = right.model.with_effect(ParasiticMode(axis=0, strength=1e-12, omega=1e5, quality=50.0))
    sweeps = replace(right.case, records=tuple(r for r in right.case.records if r.kind == "frequency_sweep"))
    with_state = sweep_forces(fit_case(sweeps, model=model, held=True))
    for a, b in zip(sweep_forces(right), with_state, strict=True):
        np.testing.assert_allclose(a.force / a.std, b.force / a.std, atol=1e-3)


def cubic_force(fit, strength, found):
    """−s·x³ of the displacement that was measured, in the band around the modes, at the times of the result."""
    record = fit.case.record("ringdown_x")
    seen = (record.signals[:, 0] - float(fit.model.offset[0])) / float(fit.model.scale[0])
    lines = np.fft.rfft(-strength * seen**3)
    hertz = np.fft.rfftfreq(seen.size, record.period)
    whole = np.fft.irfft(np.where((hertz > 1500) & (hertz < 4500), lines, 0), seen.size)
    return whole[np.isin(record.time, found.time)]


def ring_down_force(fit):
    return next(f for f in time_forces(fit) if f.record == "ringdown_x")


def test_a_quiet_ring_down_shows_the_force_over_time(right, lacking, strength):
    """A record without noise, as the right model predicts it."""
    number = [r.name for r in right.case.records].index("ringdown_x")
    clean = replace(right.case.records[number], signals=right.predicted(number), noise_std=2e-6, role="fit")
    fit = fit_case(replace(right.case, records=(clean,)), model=lacking.model, held=True)
    found = ring_down_force(fit)
    true = cubic_force(fit, strength, found)
    assert np.sqrt(np.mean((found.force[:, 0] - true) ** 2)) < 0.03 * np.sqrt(np.mean(true**2))
    motion = (clean.signals - np.asarray(fit.model.offset)) / np.asarray(fit.model.scale)
    law = found.as_seen(-strength * motion**3)[:, 0]
    assert np.sqrt(np.mean((law - found.force[:, 0]) ** 2)) < 0.03 * np.sqrt(np.mean(true**2)), "as the law would be"
    even = found.as_seen(motion**2)[:, 0]
    assert abs(even.mean()) < 0.01 * np.mean(motion[:, 0] ** 2), "but for a mean"
    assert np.sqrt(np.mean(found.force[:, 1] ** 2)) < 0.03 * np.sqrt(np.mean(true**2))
    early, late = found.against_time().mean[[3, -3], 0]
    assert early > 5 * late, "the spring hardens with amplitude"
    spring = found.against_displacement(0)
    outer = np.abs(spring.centre) > 0.5 * np.max(np.abs(spring.centre))
    assert np.all(spring.mean[outer] * spring.centre[outer] < 0), "it pulls back"
    damper = found.against_velocity(0)
    assert np.mean(np.abs(damper.mean)) < 0.2 * np.mean(np.abs(spring.mean))


def test_a_measured_ring_down_shows_it_through_the_noise(lacking, strength):
    found = ring_down_force(lacking)
    true = cubic_force(lacking, strength, found)
    assert found.force[:, 0] @ true / (true @ true) == pytest.approx(1.0, abs=0.15)
    assert np.corrcoef(found.force[:, 0], true)[0, 1] > 0.8


def test_noise_leaves_nothing_and_a_line_stays():
    rng = np.random.default_rng(0)
    noise = np.sqrt(250.0) * (rng.standard_normal((2000, 2)) + 1j * rng.standard_normal((2000, 2)))
    assert not weight_above_noise(noise, 500.0).any()
    lines = noise.copy()
    lines[1000:1009, 0] += 40 * np.sqrt(500.0)
    kept = lines * weight_above_noise(lines, 500.0)
    assert not kept[:, 1].any()
    assert np.flatnonzero(kept[:, 0]).min() > 990
    assert np.flatnonzero(kept[:, 0]).max() < 1018
    np.testing.assert_allclose(kept[1003:1006, 0], lines[1003:1006, 0], rtol=0.01)


def test_a_rate_table_shows_what_depends_on_rate(right):
    """A scale error of the rate is a line through zero in the sense channel."""
    (quiet,) = rate_residuals(right)
    assert np.mean((quiet.rate.mean / quiet.rate.error) ** 2) < 2.0
    scaled = eqx.tree_at(lambda m: m.device.mobility, right.model, right.model.device.mobility * 1.05)
    (found,) = rate_residuals(fit_case(right.case, model=scaled, held=True))
    assert np.mean((found.time.mean / found.time.error) ** 2) > 10.0


def test_bins_are_means_with_their_error():
    rng = np.random.default_rng(2)
    variable = rng.uniform(0, 1, 4000)
    values = 3.0 * variable + rng.standard_normal(4000)
    for blocks in (0, 16):
        found = in_bins(values, variable, 10, blocks=blocks)
        normal = (found.mean - 3.0 * found.centre) / found.error
        assert found.centre.size == 10
        assert np.max(np.abs(normal)) < 5
        assert np.mean(normal**2) > 0.2
    assert in_bins(values, np.zeros(4000), 10).centre.size == 1


def test_effects_that_are_absent_do_not_count(right):
    assert [e.label for e in right.model.present.effects] == ["cubic_stiffness x"]
