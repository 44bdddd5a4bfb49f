"""What is free by name: bounds, coordinates, the tree of `memsgyro_jax.free`, and what became of each number."""

import warnings
from types import SimpleNamespace

import equinox as eqx
import jax
import numpy as np
import pytest
import xarray as xr

import memsgyro_jax as mg
from memsgyro_jax.base.errors import InputError
from memsgyro_jax.base.transforms import from_vector, names, to_vector
from memsgyro_jax.montecarlo.batch import Plan
from memsgyro_jax.montecarlo.status import OK
from memsgyro_jax.tuning.caveats import margin_eaten, warnings_of
from memsgyro_jax.tuning.descent import Descent, DescentStep, Judged, descend, sought
from memsgyro_jax.tuning.fates import fates, null_directions
from memsgyro_jax.tuning.objective import Values
from memsgyro_jax.tuning.result import Interval, Merit, merit_of, ratio_of
from memsgyro_jax.tuning.right import LEVEL, nees_interval, nis_interval
from memsgyro_jax.tuning.tunable import resolved, tree


GYRO, READOUT = mg.SingleMassGyro.chi2010(), mg.ChargeAmplifier.chi2010()
NOISE = mg.ProcessNoise.of(GYRO.model, rate=100.0)
OBSERVER = mg.ExtendedKalmanFilter.for_device(GYRO, READOUT, process_noise=NOISE, annealing=mg.Annealing())
LOOP = mg.ClosedLoop(
    GYRO, READOUT, OBSERVER, mg.DampingCompensation(mg.Tone(600.0, 53.95, 0.1)), filter=mg.Lowpass(100.0, 2)
)
FREE = mg.free(
    {"controller.tones.0.0.phase": (-3.0, 3.0)}, observer=("noise_density", "process_noise.rate"), filter="bandwidth"
)


@pytest.fixture(scope="module")
def made():
    return resolved(LOOP, FREE, 100e3, 0.1)


def test_names_lead_to_numbers_in_the_order_of_the_tree(made):
    assert made.labels == (
        "observer.noise_density.0", "observer.noise_density.1", "observer.process_noise.rate",
        "controller.tones.0.0.phase", "filter.bandwidth",
    )  # fmt: skip
    assert made.values[2:].tolist() == [100.0, 0.1, 100.0]


@pytest.mark.parametrize(
    "spelled", ["observer.noise_density", ["observer.noise_density"], mg.free(observer="noise_density"),
                {"observer.noise_density": None}],
)  # fmt: skip
def test_what_is_free_may_be_spelled_in_any_way(spelled):
    paths = resolved(LOOP, spelled, 100e3, 0.1).paths
    assert paths == ("observer.noise_density.0", "observer.noise_density.1")
    with pytest.raises(mg.InputError, match=r"must hold paths .* but holds 3"):
        resolved(LOOP, 3, 100e3, 0.1)


def test_default_bounds(made):
    assert made.high[0] / made.low[0] == pytest.approx(1e6)
    assert made.high[2] == pytest.approx((10.0 * 3.0) ** 2 / 0.1)  # a walk of ten prior deviations in the run
    assert made.high[4] == pytest.approx(45e3)  # a bandwidth stays below half the sample rate


def test_coordinates_and_numbers_are_one_to_one(made):
    at = made.coordinates + np.linspace(-1.0, 1.0, 5)
    again = made.chosen([True] * 5, made.numbers(at)).coordinates
    assert again == pytest.approx(at, rel=1e-9)
    step = 1e-5
    for i in range(5):
        unit = np.eye(5)[i] * step
        slope = (made.numbers(at + unit) - made.numbers(at - unit))[i] / (2.0 * step)
        assert made.stretch(at)[i] == pytest.approx(slope, rel=1e-7)


def test_the_tree_is_that_of_what_is_free(made):
    spec = tree(LOOP, FREE)
    vector = to_vector(LOOP, spec)
    assert len(names(LOOP, spec)) == 5
    back = from_vector(vector, LOOP, spec)
    assert float(back.filter.bandwidth) == pytest.approx(100.0)
    assert jax.tree.structure(back) == jax.tree.structure(LOOP)


def test_what_is_off_starts_at_its_lower_bound():
    off = resolved(LOOP, mg.free("observer.process_noise.kxx"), 100e3, 0.1)
    assert off.values[0] == off.low[0] > 0.0
    assert np.isfinite(off.coordinates[0])


def test_bounds_and_priors_are_read_with_their_units():
    plain = resolved(LOOP, mg.free(mg.Tunable("filter.bandwidth", 5.0, 2e3, (50.0, 1.1))), 100e3, 0.1)
    text = resolved(LOOP, mg.free(mg.Tunable("filter.bandwidth", "5 Hz", "2 kHz", ("0.05 kHz", 1.1))), 100e3, 0.1)
    assert [*text.low, *text.high, *text.priors[0]] == pytest.approx([*plain.low, *plain.high, *plain.priors[0]])
    density = resolved(LOOP, {"observer.noise_density.0": ("0.01 uV/sqrt(Hz)", "1 mV/sqrt(Hz)")}, 100e3, 0.1)
    assert [*density.low, *density.high] == pytest.approx([1e-8, 1e-3])
    with pytest.raises(InputError, match=r"Argument `filter.bandwidth`: .*"):
        resolved(LOOP, {"filter.bandwidth": ("5 V", "2 kHz")}, 100e3, 0.1)


def test_a_loop_brought_near_oscillation_is_told():
    gyro = mg.SingleMassGyro.from_modes(1e-8, (10e3, 10.3e3), (2000.0, 300.0))

    def loop(faster):
        control = mg.ClassicControl.force_rebalance(gyro, READOUT, amplitude=1e-6, demodulator_bandwidth=500.0)
        control = eqx.tree_at(lambda c: c.sense.integral, control, faster * control.sense.integral)
        return mg.ClosedLoop(gyro, READOUT, mg.NoObserver.for_device(gyro, READOUT), control, start=(0.0,) * 4)

    assert margin_eaten(loop(1.0), loop(1.1)) == ()
    (said,) = margin_eaten(loop(1.0), loop(3.0))
    least = float(mg.loop_margins(loop(3.0)).rate)
    assert 0.0 < least < 0.5
    assert said.startswith(f"the rate loop comes as near as {least:.2g} to -1")
    assert margin_eaten(loop(3.0), loop(3.0)) == (), "it was as near before"
    assert margin_eaten(LOOP, LOOP) == ()


def test_a_prior_needs_to_lie_within_the_bounds():
    with pytest.raises(InputError, match=r"The prior of `filter.bandwidth` must be"):
        resolved(LOOP, mg.free(mg.Tunable("filter.bandwidth", 1.0, 1e3, (2e3, 2.0))), 100e3, 0.1)


def test_a_prior_is_one_of_the_logarithm():
    held = resolved(LOOP, mg.free(mg.Tunable("filter.bandwidth", 1.0, 1e4, (50.0, 1.1))), 100e3, 0.1)
    there = held.chosen([True], np.array([50.0 * 1.1])).coordinates
    value, slope = held.prior(there)
    assert value == pytest.approx(0.5, rel=0.03)
    parts = [held.prior(there + step)[0] for step in (-1e-4, 1e-4)]
    assert slope[0] == pytest.approx((parts[1] - parts[0]) / 2e-4, rel=1e-6)
    with pytest.raises(InputError, match="must belong to a number that is tuned by likelihood"):
        mg.tune(LOOP, free=mg.free(mg.Tunable("filter.bandwidth", 1.0, 1e4, (50.0, 1.1))))


def valley(at):
    """A narrow curved valley with its floor at (1, 1), and slopes of dies that scatter about its own."""
    x, y = at
    value = (1.0 - x) ** 2 + 30.0 * (y - x**2) ** 2
    slope = np.array([-2.0 * (1.0 - x) - 120.0 * x * (y - x**2), 60.0 * (y - x**2)])
    return Judged(value, slope, slope[:, None] + np.array([[1.0, -1.0, 0.0], [0.0, 1.0, -1.0]]), 1e-3)


def test_a_valley_is_followed_to_its_floor():
    found = descend(valley, lambda at: valley(at)[0], np.array([-1.0, 1.0]), evaluations=80)
    assert found.coordinates == pytest.approx([1.0, 1.0], abs=0.02)
    assert found.status.startswith("converged")
    losses = [step.training for step in found.steps]
    assert losses == sorted(losses, reverse=True)


def test_the_best_on_validation_counts():
    found = descend(valley, lambda at: float((at[0] + 0.5) ** 2), np.array([-1.0, 1.0]), evaluations=80)
    assert found.status.startswith("stopped early")
    assert abs(found.coordinates[0] + 0.5) == min(abs(step.coordinates[0] + 0.5) for step in found.steps)


def test_without_any_effect_nothing_moves():
    flat = lambda at: Judged(1.0, np.zeros(2), np.zeros((2, 3)), 1.0)  # noqa: E731
    found = descend(flat, lambda at: 1.0, np.zeros(2), evaluations=5)
    assert found.status == "nothing free has an effect"
    assert found.coordinates.tolist() == [0.0, 0.0]


@pytest.mark.parametrize("brink", [-np.inf, -0.5])
def test_numbers_beyond_all_sizes_warn_nobody(brink):
    """Of a slope that stays SciPy warns, NumPy of what is infinite beyond a brink."""

    def plane(at):
        slope = np.ones(2) if at[0] > brink else np.array([np.inf, -np.inf])
        return Judged(float(np.sum(at)) if at[0] > brink else np.inf, slope, slope[:, None] * [1.0, 2.0, 3.0], 1e-3)

    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = descend(plane, lambda at: float(np.sum(at)), np.zeros(2), evaluations=9).coordinates
    assert brink < found[0] < -0.2


def test_a_rescue_goes_down_again():
    def down(start, left):
        return Descent((DescentStep(1, float(start[0]), float(start[0]), start),), 0, f"{left} left")

    starts = iter([np.array([2.0]), np.array([1.0]), None])
    found = sought(down, lambda end: next(starts), np.array([3.0]), 10)
    assert [step.evaluations for step in found.steps] == [1, 2, 3]
    assert found.coordinates.tolist() == [1.0]
    assert found.status.startswith("8 left; what stands is the best of a coarse grid")


@pytest.mark.parametrize("of_grid", [False, True])
@pytest.mark.parametrize(("bettered", "rescue"), [(False, None), (True, None), (False, 2.0), (True, 2.0)])
def test_a_best_place_of_a_grid_says_so(of_grid, bettered, rescue):
    def down(start, left):
        places = [start, 0.5 * start] if bettered else [start]
        steps = (DescentStep(n + 1, float(at[0]), float(at[0]), at) for n, at in enumerate(places))
        return Descent(tuple(steps), len(places) - 1, "converged")

    moved = iter([None if rescue is None else np.array([rescue]), None])
    found = sought(down, lambda end: next(moved), np.array([3.0]), 10, of_grid=of_grid)
    coarse = not bettered and (of_grid or rescue is not None)
    assert found.status.startswith("converged")
    assert ("coarse grid" in found.status) is coarse


def test_each_number_has_a_fate(made):
    few = made.chosen([True, True, True, False, True], made.values)
    found = few.values * np.array([2.0, 2.0, 1.0, 1.0])
    found[3] = few.high[3] * 0.999
    rng = np.random.default_rng(0)
    along = rng.normal(size=50)
    # The dies feel the first two numbers only through their ratio, and the bandwidth not at all.
    slopes = np.stack([along / found[0], -along / found[1], rng.normal(size=50) / found[2], 0.0 * along])
    values = Values(rng.normal(size=50), np.ones(50, bool), slopes)
    assert fates(few, found, values) == (
        "moved x 2, in a direction without effect", "moved x 2, in a direction without effect", "stayed",
        "moved x 450, at its upper bound, small changes there have no effect",
    )  # fmt: skip
    assert null_directions(few, found, values) == ("+0.71·observer.noise_density.0 +0.71·observer.noise_density.1",)


def merit(mean, nis=(1.0, 1.0), nees=14.0, lost=0):
    figure = Interval(mean, mean, mean)
    return Merit(figure, figure, figure, 256, lost, nis, nees, 14, (13.1, 14.9))


@pytest.mark.parametrize(
    ("after", "low", "words"),
    [
        (merit(0.5), 0.4, []),
        (
            merit(0.5, nis=(1.3, 1.0)),
            0.4,
            ["absorbing an error of the model", "NIS is 1.3, 1 instead of 1"],
        ),
        (merit(0.5, nees=30.0), 0.4, ["absorbing an error of the model", "NEES is 30 instead of 14"]),
        (
            merit(0.5, nees=10.0),
            0.4,
            ["NEES is 10 instead of 14", "claims more error than it makes; a read-out noise", "a prior wider"],
        ),
        (merit(0.5, nis=(0.7, 1.3)), 0.4, ["absorbing an error of the model"]),
        (merit(0.5, lost=2), 0.4, ["2 of 256 unseen dies are lost"]),
        (merit(1.05), 0.9, []),
        (merit(1.5), 1.2, ["has risen to 1.5 (1.2 to 1.8) of that before, by an interval of 99.5 %"]),
    ],
)
def test_warnings(after, low, words):
    value = after.mean.value
    said = " ".join(warnings_of(after, 0, Interval(value, low, 2.0 * value - low)))
    assert bool(said) == bool(words)
    assert all(word in said for word in words)


def test_right_loops_are_warned_of_at_the_stated_level():
    """100 lots of 64 dies as a right filter leaves them, errors as unequal as those of dies: the share that is told."""
    rng, told, figure = np.random.default_rng(3), 0, Interval(1.0, 1.0, 1.0)
    for _ in range(100):
        nees, nis = rng.chisquare(14, 64), rng.chisquare(90, (2, 64)) / 90
        around = nis_interval(64, 90), nis_interval(64, 90)
        own = Merit(figure, figure, figure, 64, 0, tuple(nis.mean(axis=1)), nees.mean(), 14.0,
                    nees_interval(64, 14, 14.0), around)  # fmt: skip
        size = rng.lognormal(0.0, 1.0, 64)
        lots = [Squares(size * rng.chisquare(20, 64) / 20) for _ in range(2)]
        told += bool(warnings_of(own, 0, ratio_of(*lots, level=1.0 - 0.5 * LEVEL)))
    assert told <= 5, "of 100 one is expected"


def test_a_wrong_filter_does_not_widen_what_it_is_judged_by():
    """Of one told a fiftieth of the walk, whose dies differ by as much as it is wrong."""
    rng = np.random.default_rng(5)
    plan = {"period": 1e-5, "blocks": 100, "block": 10, "settle": 5e-3, "tolerance": 0.3}
    rows = {
        "status": ("die", np.full(16, OK)),
        "rate_error_rms": ("die", np.ones(16)),
        "nees_end": ("die", 69.0 * rng.chisquare(1, 16)),
        "nis_channel": (("die", "channel"), 880.0 * rng.chisquare(8, (16, 2)) / 8),
    }
    data = xr.Dataset(rows, attrs=Plan(**plan)._asdict())
    wrong = merit_of(SimpleNamespace(data=data, summary=SimpleNamespace(nees=float(data.nees_end.mean()), states=5)))
    assert wrong.consistent is False
    assert "NIS is" in wrong.inconsistency
    assert "NEES is" in wrong.inconsistency
    (low, high), (least, most) = wrong.nees_interval, wrong.nis_interval[0]
    assert 2.0 < low < 5.0 < high < 8.0
    assert (least, most) == (0.9, 1.1), "8000 innovations say nothing wider"


class Squares:
    """Of a lot, the mean squared errors alone."""

    def __init__(self, squares):
        self.data = xr.Dataset({"rate_error_rms": ("die", np.sqrt(squares))})
