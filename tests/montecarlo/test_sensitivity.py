"""Sensitivities: against functions whose indices are known, and what happens to lost dies and shared noise."""

from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats

import memsgyro_jax as mg
from memsgyro_jax.base.errors import InputError
from memsgyro_jax.loop.scenario import as_scenario
from memsgyro_jax.montecarlo.runner import Runner
from memsgyro_jax.montecarlo.sensitivity.corners import signs_of
from memsgyro_jax.montecarlo.sensitivity.outputs import outputs
from memsgyro_jax.montecarlo.sensitivity.points import not_normal
from memsgyro_jax.montecarlo.sensitivity.sobol import designed_points, indices_of
from memsgyro_jax.montecarlo.spread import Points


SHORT = {"sample_rate": 50e3, "duration": 2e-3, "tolerance": 1.0, "chunk": 96}  # one program for 3 dies and for 160
PAIR = mg.Spread((mg.Vary("device.dxy", mg.Normal(relative=0.1)), mg.Vary("device.kxx", mg.Normal(relative=0.02))))


@pytest.fixture(scope="module")
def loop() -> mg.ClosedLoop:
    """With a filter that estimates the motion and the rate alone: it compiles in a fraction of the time."""
    gyro, readout = mg.SingleMassGyro.chi2010(), mg.ChargeAmplifier.chi2010()
    known = tuple(name for name in gyro.model.names if name != "rate")
    observer = mg.ExtendedKalmanFilter.for_device(gyro, readout, known=known, with_offsets=False)
    return mg.ClosedLoop(gyro, readout, observer, mg.OpenLoop())


def drawn(place: int, power: int = 1) -> mg.Output:
    """A figure that depends on one drawn number alone."""
    return mg.Output("drawn", "SI", lambda rows: rows["drawn"][:, place] ** power)


# ---- the estimator


def ishigami(x):
    return np.sin(x[0]) + 7.0 * np.sin(x[1]) ** 2 + 0.1 * x[2] ** 4 * np.sin(x[0])


def ishigami_sets(points, seed):
    uniform = stats.qmc.Sobol(6, rng=np.random.default_rng(seed)).random(points).T
    a, b = np.pi * (2 * uniform[:3] - 1), np.pi * (2 * uniform[3:] - 1)
    mixed = [np.where(np.arange(3)[:, None] == i, b, a) for i in range(3)]
    return np.stack([ishigami(x) for x in (a, b, *mixed)])


def test_the_indices_of_the_ishigami_function():
    """Exact values: Sobol and Levitan (1999), with a = 7, b = 0.1."""
    variance = 49 / 8 + 0.1 * np.pi**4 / 5 + 0.01 * np.pi**8 / 18 + 0.5
    alone = np.array([0.5 * (1 + 0.1 * np.pi**4 / 5) ** 2, 49 / 8, 0.0]) / variance
    together = 0.01 * np.pi**8 * (1 / 18 - 1 / 50) / variance
    first, total, first_interval, total_interval, dropped = indices_of(
        ishigami_sets(2**12, 0), 0.95, np.random.default_rng(0)
    )
    np.testing.assert_allclose(first, alone, atol=0.02)
    np.testing.assert_allclose(total, np.add(alone, [together, 0.0, together]), atol=0.02)
    assert dropped == 0
    for value, interval in ((first, first_interval), (total, total_interval)):
        assert np.all((interval[:, 0] < value) & (value < interval[:, 1]))


def test_the_indices_are_those_of_scipy():
    values = ishigami_sets(64, 1)
    ours = indices_of(values, 0.95, np.random.default_rng(0))
    theirs = stats.sobol_indices(func={"f_A": values[:1], "f_B": values[1:2], "f_AB": values[2:, None]}, n=64)
    np.testing.assert_allclose(ours[0], theirs.first_order, rtol=1e-12)
    np.testing.assert_allclose(ours[1], theirs.total_order, rtol=1e-12)


@pytest.mark.slow
def test_intervals_hold_the_truth_as_often_as_they_say():
    """Second input, exact index 0.4424, in 95 % of 60 repeats; four standard deviations of that share are 11 %."""
    exact = 49 / 8 / (49 / 8 + 0.1 * np.pi**4 / 5 + 0.01 * np.pi**8 / 18 + 0.5)
    rng = np.random.default_rng(3)
    held = 0
    for _ in range(60):
        a, b = np.pi * (2 * rng.random((2, 3, 256)) - 1)
        mixed = [np.where(np.arange(3)[:, None] == i, b, a) for i in range(3)]
        ends = indices_of(np.stack([ishigami(x) for x in (a, b, *mixed)]), 0.95, rng)[3][1]
        held += ends[0] <= exact <= ends[1]
    assert held / 60 >= 0.83


def test_a_die_with_one_input_of_b_has_the_noise_of_its_die_in_a():
    points = designed_points(2, 8, 0)
    a, b, first, second, noisy = points.normal.reshape(5, 8, 2)
    np.testing.assert_array_equal(first, np.stack([b[:, 0], a[:, 1]], axis=1))
    np.testing.assert_array_equal(second, np.stack([a[:, 0], b[:, 1]], axis=1))
    np.testing.assert_array_equal(noisy, a)
    own, other = np.arange(8), np.arange(8, 16)
    np.testing.assert_array_equal(points.noise.reshape(5, 8), [own, other, own, own, other])


def test_points_with_a_lost_die_are_left_out_and_counted():
    values = ishigami_sets(64, 1)
    spoiled = values.copy()
    spoiled[3, [5, 9]] = np.nan
    ours = indices_of(spoiled, 0.95, np.random.default_rng(0))
    kept = indices_of(np.delete(values, [5, 9], axis=1), 0.95, np.random.default_rng(0))
    assert ours[4] == 2
    np.testing.assert_array_equal(ours[0], kept[0])


def test_an_output_that_nearly_never_differs_has_no_indices():
    """Share of lost dies: 19 of 256 dies of both sets would say which dies were drawn, 20 have indices."""
    values = np.zeros((5, 128))
    values[0, :19] = 1.0
    first, total, *intervals, dropped = indices_of(values, 0.95, np.random.default_rng(0))
    assert np.all(np.isnan([first, total]))
    assert np.all(np.isnan(intervals))
    assert dropped == 0
    values[1, 50] = 1.0
    assert np.all(np.isfinite(indices_of(values, 0.95, np.random.default_rng(0))[1]))
    assert np.all(np.isnan(indices_of(1.0 - values * (np.arange(128) < 19), 0.95, np.random.default_rng(0))[1]))


def sobol_of(values, points):
    """A result as `sobol` makes it of one output of two inputs."""
    first, total, *intervals, dropped = (part[None] for part in indices_of(values, 0.95, np.random.default_rng(0)))
    return mg.Sobol(
        ("error",), ("deg/s",), ("a", "b", "noise"), None, first, total, *intervals,
        np.nanmean(values[:2])[None], np.nanstd(values[:2])[None], points, dropped, 0, values.size, 0.95,
    )  # fmt: skip


def test_too_few_points_are_called_so_and_how_many_it_takes_is_told():
    """All 16 dies of 8 points differ; what lacks are points, and with lost dies more of them."""
    said = repr(sobol_of(ishigami_sets(8, 1), 8))
    assert "no indices, because 8 points are too few of at least 11; give `points` = 16 or" in said
    assert "the same for all" not in said
    spoiled = ishigami_sets(16, 1)
    spoiled[0, :6] = np.nan
    assert "10 points without a lost die are too few of at least 11; give `points` = 32" in repr(sobol_of(spoiled, 16))
    rare = np.zeros((5, 128))
    rare[0, :19] = 1.0
    assert "the same for all but fewer than 20 dies" in repr(sobol_of(rare, 128))


def test_an_index_below_its_uncertainty_is_not_told():
    few, many = sobol_of(ishigami_sets(16, 1), 16), sobol_of(ishigami_sets(2**12, 0), 2**12)
    figures = (few.first, few.first_interval), (few.total, few.total_interval)
    untold = sum(int(np.sum(np.abs(index) < 0.5 * np.ptp(ends, axis=-1))) for index, ends in figures)
    assert 0 < untold == repr(few).count("- (") < 6
    assert repr(few).endswith("more `points` narrow it")
    assert repr(many).count("- (") == 1, "the third input alone has no index of first order"


# ---- sweeps at chosen points


def test_an_input_that_is_the_output_has_all_of_the_variance(loop):
    found = mg.sobol(loop, PAIR, points=32, of=(drawn(0), drawn(1, 2)), **SHORT)
    assert found.inputs == ("device.dxy", "device.kxx", "noise")
    np.testing.assert_allclose(found.total[0], [1.0, 0.0, 0.0], atol=0.15)
    np.testing.assert_allclose(found.total[1], [0.0, 1.0, 0.0], atol=0.15)
    assert found.total[0, 1] == found.total[0, 2] == found.total[1, 0] == 0.0
    assert found.dies == 32 * 5
    assert found.to_xarray()["total"].sel(output="drawn", input="noise").shape in ((), (2,))


def test_lost_dies_are_counted_and_no_numbers(loop):
    tight = replace_travel(loop, 0.98e-6)
    found = mg.sobol(tight, PAIR, points=32, **SHORT)
    assert 0 < found.failed < found.dies
    error, lost = found.outputs.index("rms rate error"), found.outputs.index("lost")
    assert 0 < found.dropped[error] < 32
    assert found.dropped[lost] == 0
    assert 0.0 < found.mean[lost] < 1.0
    assert f"{found.failed} lost" in repr(found)


@pytest.mark.slow
def test_where_every_die_is_lost_nothing_is_claimed(loop):
    small = replace_travel(loop, 0.8e-6)
    found = mg.sobol(small, PAIR, points=32, **SHORT)
    assert found.failed == found.dies
    assert np.isnan(found.mean[0])
    assert "rms rate error: every die was lost" in repr(found)
    bars = mg.tornado(small, PAIR, repeats=4, **SHORT)
    assert np.isnan(bars.low[:2]).all()
    assert np.all(bars.lost == 1.0)
    corners = mg.corners(small, PAIR, repeats=2, **SHORT)
    assert np.isnan(corners.worst[0]).all()
    assert "rms rate error: every die was lost" in repr(corners)
    assert "nan" not in repr(corners)


def replace_travel(loop, travel):
    return mg.ClosedLoop(loop.device, loop.readout, loop.observer, loop.controller, loop.start, travel)


def test_dies_at_one_point_with_one_noise_are_the_same(loop):
    points = Points(np.zeros((3, 2)), np.array([4, 4, 5]))
    lot = mg.sweep(loop, replace(PAIR, points=points), dies=3, bound_dies=0, **SHORT)
    first, second, third = np.asarray(lot.data["rate_error_end"])
    assert first == second
    assert first != third
    row = replace(PAIR, points=Points(np.zeros((6, 2)), np.arange(6)))
    assert first == float(mg.sweep(loop, row, dies=6, bound_dies=0, **SHORT).data["rate_error_end"][4])


def test_every_corner_is_run_and_the_worst_is_first(loop, tmp_path, monkeypatch):
    settings = {"sigmas": 2.0, "repeats": 2, "of": (drawn(0),), **SHORT}
    found = mg.corners(loop, PAIR, **settings, out=tmp_path)
    with monkeypatch.context() as patch:
        patch.setattr(Runner, "_run", None)  # what is in the store is not computed again
        again = mg.corners(loop, PAIR, **settings, out=tmp_path, resume=True)
    assert repr(again) == repr(found)
    assert found.complete
    assert len({tuple(row) for row in found.signs}) == 4
    assert found.signs[found.order(0)[0], 0] == 1.0
    spread = 0.2 * float(loop.device.dxy)
    assert np.ptp(found.mean[0]) == pytest.approx(2 * spread, rel=1e-3)


@pytest.mark.parametrize("count", [8, 11, 15, 16])
def test_many_parameters_meet_in_balanced_corners(count):
    signs, complete = signs_of(count)
    assert not complete
    np.testing.assert_array_equal(signs.T @ signs, len(signs) * np.eye(count))
    np.testing.assert_array_equal(signs.sum(axis=0), 0.0)
    assert len(signs) < 8 * count


def test_the_gradient_of_a_tornado_is_that_of_the_runs_and_results_print(loop):
    per_mass = mg.Output("kxx per mass", "1/s²", lambda rows: rows["coefficient_true"][:, 1])
    stiffness = mg.Output("kxx", "N/m", lambda loop: loop.device.kxx, of_loop=True)
    off = mg.mean_error()
    found = mg.tornado(loop, PAIR, sigmas=1e-3, repeats=4, of=(*outputs(1.0), per_mass, stiffness, off), **SHORT)
    middle = 0.5 * (found.high - found.low)
    np.testing.assert_allclose(found.slope[:2], middle[:2], rtol=2e-3)  # small steps: the response is straight
    assert np.isnan(found.slope[2:4]).all()
    np.testing.assert_allclose(found.slope[4:], middle[4:], rtol=1e-3)
    # Unequal cross damping moves the mean as it moves the end, and told is what the rows of a run say.
    assert found.high[6, 0] == pytest.approx(found.high[0, 0], rel=0.3)
    rows = {"rate_true": np.ones((1, 4)), "rate_estimate": np.array([[9.0, 9.0, 2.0, 3.0]])}
    assert [float(mg.mean_error(after).of(rows)[0]) for after in (0.5, 0.75)] == [1.5, 2.0]
    told = found.as_dict()["outputs"][6]
    assert (told["name"], told["inputs"][0]["high"]) == ("mean rate error", max(found.high[6], key=abs))
    np.testing.assert_allclose(found.slope[5], [0.0, 0.02e-3 * 63.96], rtol=1e-3)
    assert np.all(found.lost == 0.0)
    assert "device.dxy" in repr(found)
    assert " at the design\n" in repr(found)
    assert found.plot().get_xlabel().startswith("change of rate error at the end")
    assert " *" not in repr(found)
    odd = replace(found, slope=30.0 * found.slope, std=0.0 * found.std)
    assert odd._text(0).count(" *") == 2 + 1, "and the sentence of what it means"
    labels = [label.get_text() for label in odd.plot().get_yticklabels()]
    assert sorted(labels) == ["device.dxy *", "device.kxx *"]
    assert "-" in replace(found, std=np.nan * found.std).rows(0)[0], "of one noise no error is told"
    straight, steep = (figure.plot().get_xlim() for figure in (replace(found, std=0.0 * found.std), odd))
    assert steep == pytest.approx(straight), "bars set the axis"
    hidden = replace(found, std=1e9 + found.std).plot().patches
    assert {bar.get_facecolor() for bar in hidden} == {(0.8, 0.8, 0.8, 1.0)}, "within their error"
    indices = mg.sobol(loop, PAIR, points=32, **SHORT)
    assert [label.get_text() for label in indices.plot(output="rms rate error").get_yticklabels()].count("noise") == 1
    with pytest.raises(InputError, match=r"Argument `output` must be one of .*, but `x` was given"):
        indices.plot(output="x")


def test_the_gradient_is_taken_where_the_bars_start_and_steps_that_are_no_deviations_are_told():
    """Of distributions about another number than the loop's own, whose bars start in their middle."""
    gyro, readout = mg.SingleMassGyro.chi2010(), mg.ChargeAmplifier.chi2010()
    loop = mg.ClosedLoop(gyro, readout, mg.NoObserver.for_device(gyro, readout), mg.OpenLoop())
    own = np.array([float(loop.device.kxx), float(loop.device.kyy)])
    pair = mg.Spread(
        (
            mg.Vary("device.kxx", mg.Uniform(low=0.99 * own[0], high=1.03 * own[0])),
            mg.Vary("device.kyy", mg.Normal(std=0.01 * own[1], mean=1.02 * own[1])),
        )
    )
    squared = [mg.Output(name, "N²/m²", _squared(name), of_loop=True) for name in ("kxx", "kyy")]
    found = mg.tornado(loop, pair, repeats=1, sigmas=2.0, of=squared, **SHORT)
    middles, steps = np.array([1.01, 1.02]) * own, np.array([0.04 * (stats.norm.cdf(2.0) - 0.5), 0.02]) * own
    np.testing.assert_allclose(found.design, middles**2, rtol=1e-9)
    np.testing.assert_allclose(np.diag(found.high), (middles + steps) ** 2 - middles**2, rtol=2e-3)
    np.testing.assert_allclose(np.diag(found.slope), 2.0 * middles * steps, rtol=2e-3)
    assert " in the middle of the spread\n" in repr(found)
    assert "at the design" not in repr(found)
    said = "Of `device.kxx`, not normal or cut near there, ∓2 σ are the 2.275 and 97.72 % points."
    assert said in found.notes
    usual = (mg.Vary("device.kxx", mg.Normal(relative=0.01)), mg.Vary("device.kyy", mg.Normal(std=0.1)))
    assert not_normal(loop, mg.Spread(usual), 2.0) == ()


def _squared(name: str):
    return lambda loop: jnp.square(getattr(loop.device, name))


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (
            lambda loop: mg.sobol(loop, PAIR, points=24),
            "`points` must be a power of two, at least 2, but is 24",
        ),
        (lambda loop: mg.sobol(loop, mg.Spread()), "must vary at least one parameter"),
        (lambda loop: mg.sobol(loop, replace(PAIR, correlation=((1.0, 0.5), (0.5, 1.0)))), "must be independent"),
        (lambda loop: mg.mean_error(1.0), "`after` must be a share"),
        (lambda loop: mg.tornado(loop, mg.Spread()), "must vary at least one parameter"),
        (lambda loop: mg.tornado(loop, PAIR, sigmas=0.0), "`sigmas` and `repeats` must be positive"),
        (lambda loop: mg.corners(loop, PAIR, repeats=0), "`sigmas` and `repeats` must be positive"),
        (lambda loop: mg.corners(loop, replace(PAIR, everywhere=mg.Normal(relative=0.4)), **SHORT), "no device can be"),
    ],
)
def test_bad_input_is_one_sentence(loop, make, words):
    with pytest.raises(InputError, match=words):
        make(loop)


def test_a_corner_that_no_device_can_be_at_is_named_with_its_cause():
    """A mode within 0.01 Hz of the other, beside a quadrature that holds them 0.06 Hz apart; a negative stiffness."""
    gyro = mg.SingleMassGyro.from_modes("20 ug", ("14 kHz", "14.003 kHz"), 1e5, quadrature="10 deg/s")
    readout = mg.DirectReadout(5e5, noise_density=1e-7)
    near = mg.ClosedLoop(gyro, readout, mg.NoObserver.for_device(gyro, readout), mg.OpenLoop())
    second = mg.Vary("device.frequency.1", mg.Normal(std=1.0, mean=14_002.99))
    spread = mg.Spread((second, mg.Vary("device.cross_damping", mg.Normal(std=0.02))))
    with pytest.raises(InputError, match="no device can be") as found:
        mg.corners(near, spread, **SHORT)
    said = str(found.value)
    assert "`device.frequency.1` = 14000" in said
    assert " Hz (-3 σ)" in said
    assert "Its modes would lie nearer to each other than its quadrature sets them apart." in said
    assert "nan" not in said
    assert "cross_damping" not in said, "one number is enough for it"
    assert "drawn" not in said
    soft = mg.Spread((mg.Vary("device.kxx", mg.Normal(relative=0.4)), mg.Vary("device.dxy", mg.Normal(std=1e-9))))
    with pytest.raises(InputError, match=r"`device.kxx` = -\S+ N/m \(-3 σ\); .* stiffness matrix must be positive"):
        mg.corners(near, soft, **SHORT)


def test_designs_carry_gradients(loop):
    """d(value of a die)/d(design) is 1 + the relative deviation."""

    def values(stiffness):
        moved = eqx.tree_at(lambda made: made.device.kxx, loop, stiffness)
        return PAIR.at(moved, as_scenario(1.0), np.array([[0.0, 1.0], [0.0, -2.0]])).loop.device.kxx

    slope = jax.jacfwd(values)(loop.device.kxx)
    np.testing.assert_allclose(slope, values(loop.device.kxx) / loop.device.kxx, rtol=1e-12)
