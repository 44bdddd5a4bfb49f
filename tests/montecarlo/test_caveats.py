"""What is said beside a yield: errors that still move, and dies whose modes have changed places."""

from dataclasses import replace

import equinox as eqx
import numpy as np
import pytest

import memsgyro_jax as mg
from memsgyro_jax.montecarlo.batch import Plan
from memsgyro_jax.montecarlo.caveats import Movement, Order, Scatter


PLAN = Plan(period=1e-3, blocks=100, block=4, settle=0.2, tolerance=0.1)
LOOP = mg.default_study().loop


def moved(errors, true=0.3) -> str | None:
    movement, true = Movement(PLAN), np.broadcast_to(true, errors.shape)
    for part in np.array_split(np.arange(len(errors)), 3):
        movement.add(true[part], (true + errors)[part])
    return movement.sentence(LOOP)


def dies_of(law, noise=0.02):
    """Window means of 32 dies: an end of their own, a `law` of time and noise."""
    rng = np.random.default_rng(0)
    ends, scatter = 0.05 * rng.standard_normal((32, 1)), noise * rng.standard_normal((32, 100))
    return ends + law(PLAN.window_times) + scatter


def test_a_yield_of_a_start_is_told_with_what_helps():
    said = moved(dies_of(lambda t: 2.0 * np.exp(-t / 0.1)))
    assert "still falls on 32 of 32 dies" in said
    assert "`duration` = 0.8 s" in said
    assert "still rises" in moved(dies_of(lambda t: 1.0 - np.exp(-t / 0.2)))


@pytest.mark.parametrize("law", [lambda t: 0.0 * t, lambda t: 2.0 * np.exp(-t / 0.02)], ids=["never", "before"])
def test_what_rests_is_left_alone(law):
    assert moved(dies_of(law)) is None


def test_what_changes_no_yield_is_left_alone():
    assert moved(0.01 * dies_of(lambda t: 2.0 * np.exp(-t / 0.1))) is None
    assert moved(dies_of(lambda t: 2.0 * np.exp(-t / 0.1)), np.sin(np.arange(100.0))) is None, "a rate that varies"
    assert Movement(PLAN._replace(blocks=3)).sentence(LOOP) is None, "too few windows"


def scattered(errors, true=0.3) -> str | None:
    scatter, true = Scatter(PLAN), np.broadcast_to(true, errors.shape)
    for part in np.array_split(np.arange(len(errors)), 3):
        scatter.add(true[part], (true + errors)[part])
    return scatter.sentence(LOOP)


@pytest.mark.parametrize(
    "law",
    [lambda t: 40.0 * np.exp(-t / 0.04) * np.cos(900.0 * t), lambda t: 80.0 * np.exp(-t / 0.04)],
    ids=["beat", "decay"],
)
def test_dies_that_still_pull_in_are_no_noise(law):
    """Of a lot beside a phase-locked loop's band 6.08 deg/s of scatter were told, where its noise is 0.2."""
    noise = dies_of(lambda t: 0.0 * t)
    some = np.where(np.arange(32)[:, None] % 4 == 0, noise + law(PLAN.window_times), noise)
    said = scattered(some)
    assert said.startswith("8 of 32 dies still move within the settled part, which is no noise")
    late = float(said.split(" deg/s from there on")[0].split()[-1])
    assert late == pytest.approx(np.degrees(0.02), rel=0.1)
    assert "`duration` = 0.8 s" in said
    assert scattered(some[:, ::-1]) is None, "what grows is no start"


def test_noise_that_wanders_is_no_start():
    assert scattered(dies_of(lambda t: 0.0 * t)) is None
    rng = np.random.default_rng(1)
    assert scattered(np.cumsum(rng.standard_normal((400, 100)), axis=1)) is None
    assert scattered(dies_of(lambda t: 0.0 * t), np.sin(np.arange(100.0))) is None, "a rate that varies"
    assert Scatter(PLAN._replace(blocks=3)).sentence(LOOP) is None, "too few windows"


def test_dies_whose_modes_have_changed_places_are_counted():
    order, (x, y) = Order.of(LOOP), (LOOP.device.kxx, LOOP.device.kyy)
    theta = np.array([LOOP.device.coefficients(0.0)] * 3, float)
    theta[1, order.x] = 1.01 * theta[1, order.y]
    np.testing.assert_array_equal(order.crossed(theta), [False, True, False])
    assert order.sentence([1], 1, 3).startswith("1 of 3 (1): mode y below mode x, unlike the design")
    swapped = eqx.tree_at(lambda made: (made.kxx, made.kyy), LOOP.device, (y, x))
    assert "mode x below mode y" in Order.of(replace(LOOP, device=swapped)).sentence([1], 1, 3)
    assert Order.of(replace(LOOP, device=eqx.tree_at(lambda made: made.kyy, LOOP.device, x))) is None, "matched"
