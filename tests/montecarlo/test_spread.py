"""Fabrication spread: distributions, correlation, and the identity of a die."""

import jax
import numpy as np
import pytest
from scipy import stats

import memsgyro_jax as mg
from memsgyro_jax.base.errors import InputError
from memsgyro_jax.device.sizes import numbers_of
from memsgyro_jax.loop.scenario import as_scenario


READOUT = mg.ChargeAmplifier.chi2010()


@pytest.fixture(scope="module")
def loop() -> mg.ClosedLoop:
    gyro, readout = mg.SingleMassGyro.chi2010(), mg.ChargeAmplifier.chi2010()
    return mg.ClosedLoop(gyro, readout, mg.ExtendedKalmanFilter.for_device(gyro, readout), mg.OpenLoop())


def draw(loop, spread, dies, seed=0, scenario=1.0):
    return spread.draw(loop, as_scenario(scenario), seed, np.asarray(dies))


def test_every_device_parameter_varies_but_one_that_is_zero(loop):
    names = ("mass", "kxx", "kyy", "kxy", "dxx", "dyy", "dxy")
    assert numbers_of(loop.device) == names
    drawn = draw(loop, mg.Spread.relative(0.1), range(4))
    assert drawn.parameters == tuple(f"device.{name}" for name in names)
    assert drawn.loop.device.kxx.shape == (4,)
    assert drawn.loop.device.cross_damping_asymmetry.shape == ()
    np.testing.assert_array_equal(drawn.table[:, 1], drawn.loop.device.kxx)


NAMED = {"frequency": (9e3, 9.3e3), "quality_factor": (5e3, 400.0), "quadrature": 0.3}
MADE = {
    "single": lambda more: mg.SingleMassGyro.from_modes(2e-8, **more),
    "dual": lambda more: mg.DualMassGyro.from_modes(3e-8, 2e-8, **more),
}


@pytest.mark.parametrize(
    ("kind", "path", "to", "instead"),
    [
        ("single", "frequency.1", 8.7e3, ["kyy"]), ("single", "quality_factor.0", 800.0, ["dxx"]),
        ("single", "quadrature", 0.7, ["kxy"]), ("single", "angle", 0.2, ["kxy"]),
        ("single", "cross_damping", 0.1, ["dxy"]), ("dual", "frequency.0", 9.2e3, ["kxx"]),
        ("dual", "quality_factor.1", 800.0, ["dyy"]), ("dual", "quadrature", 0.7, ["kxy", "kyx"]),
    ],
)  # fmt: skip
def test_a_die_with_another_quadrature_is_what_from_modes_makes_of_it(kind, path, to, instead):
    """By every name that `from_modes` has; the coefficient it stands for varies no more by itself."""
    name, _, place = path.partition(".")
    given = {**NAMED, name: to if not place else tuple(to if str(n) == place else v for n, v in enumerate(NAMED[name]))}
    if name == "angle":
        del given["quadrature"]
    gyro = MADE[kind](NAMED)
    own = mg.ClosedLoop(gyro, READOUT, mg.ExtendedKalmanFilter.for_device(gyro, READOUT), mg.OpenLoop())
    vary = mg.Vary(f"device.{path}", mg.Normal(std=1e-12, mean=to))
    drawn = draw(own, mg.Spread((vary,)), range(3)).loop.device
    for one, wanted in zip(jax.tree.leaves(drawn), jax.tree.leaves(MADE[kind](given)), strict=True):
        np.testing.assert_allclose(one, np.broadcast_to(wanted, one.shape), rtol=1e-8, atol=1e-18)
    both = {item.path for item in mg.Spread((vary,), everywhere=mg.Normal(relative=0.01)).resolved(own)}
    left = {f"device.{name}" for name in numbers_of(own.device)} - both
    assert left == {f"device.{name}" for name in instead}


def test_names_of_a_designer_that_cannot_be(loop):
    both = tuple(mg.Vary(f"device.{name}", mg.Normal(std=0.1)) for name in ("angle", "quadrature"))
    with pytest.raises(InputError, match=r"Of `angle` and `quadrature` of a device one"):
        draw(loop, mg.Spread(both), range(2))
    far = draw(loop, mg.Spread((mg.Vary("device.quadrature", mg.Normal(relative=1.0)),)), range(64))
    assert np.any(far.redrawn), "modes this near do not couple as much"
    assert np.all(np.isfinite(far.loop.device.kxy))
    with pytest.raises(InputError, match=r"no `quadratur` \(did you mean `quadrature`\? known are mass, kxx.* angle"):
        draw(loop, mg.Spread((mg.Vary("device.quadratur", mg.Normal(std=0.1)),)), range(2))


@pytest.mark.parametrize("quasi", [True, False])
def test_a_die_is_the_same_in_any_company(loop, quasi):
    spread = mg.Spread.relative(0.15, quasi=quasi)
    whole = draw(loop, spread, range(33)).table
    np.testing.assert_array_equal(draw(loop, spread, [17]).table[0], whole[17])
    np.testing.assert_array_equal(draw(loop, spread, [32, 0, 5]).table, whole[[32, 0, 5]])
    assert np.any(draw(loop, spread, [17], seed=1).table != whole[17])


@pytest.mark.parametrize("quasi", [True, False])
def test_the_distributions_are_what_they_say(loop, quasi):
    spread = mg.Spread(
        (
            mg.Vary("device.kxx", mg.Normal(relative=0.1)),
            mg.Vary("readout.opamp_offset.0", mg.Uniform(low=1e-3, high=3e-3)),
        ),
        quasi=quasi,
    )
    table = draw(loop, spread, range(1024)).table
    cut = stats.truncnorm(-4, 4, loc=63.96, scale=6.396)
    assert stats.kstest(table[:, 0], cut.cdf).pvalue > 1e-3
    assert stats.kstest(table[:, 1], stats.uniform(1e-3, 2e-3).cdf).pvalue > 1e-3
    assert abs(np.corrcoef(table.T)[0, 1]) < 4.0 / np.sqrt(1024)


def test_values_of_a_distribution_by_hand():
    ends = np.array([0.0, 0.5, 1.0])
    np.testing.assert_allclose(mg.Uniform(relative=0.2).value(5.0, ends), [4.0, 5.0, 6.0], rtol=1e-14)
    np.testing.assert_allclose(mg.Uniform(low=-1.0, high=3.0).value(5.0, ends), [-1.0, 1.0, 3.0], rtol=1e-14)
    np.testing.assert_allclose(mg.Normal(relative=0.3, std=2.0).value(-5.0, ends[1:]), [-3.75, -2.5], rtol=1e-14)
    np.testing.assert_allclose(mg.Normal(std=2.0, mean=1.0).value(-5.0, ends[1:]), [2.0, 3.0], rtol=1e-14)


PAIR = tuple(mg.Vary(f"device.{name}", mg.Normal(relative=0.1)) for name in ("kxx", "kyy"))


def test_correlation_is_kept(loop):
    table = draw(loop, mg.Spread(PAIR, correlation=((1.0, 0.8), (0.8, 1.0))), range(1024)).table
    assert np.corrcoef(table.T)[0, 1] == pytest.approx(0.8, abs=0.04)
    for sign in (-1.0, 1.0):
        table = draw(loop, mg.Spread(PAIR, correlation=((1.0, sign), (sign, 1.0))), range(64)).table
        x, y = (column / np.mean(column) - 1.0 for column in table.T)
        np.testing.assert_allclose(y - np.mean(y), sign * (x - np.mean(x)), atol=1e-3)
        assert np.std(x) == pytest.approx(0.1, rel=0.1)


def test_a_named_parameter_keeps_its_own_distribution(loop):
    spread = mg.Spread((mg.Vary("device.kxy", mg.Uniform(relative=0.01)),), everywhere=mg.Normal(relative=0.15))
    drawn = draw(loop, spread, range(64))
    assert drawn.parameters.count("device.kxy") == 1
    assert np.ptp(drawn.table[:, drawn.parameters.index("device.kxy")]) < 0.0201 * 12.78


def test_the_scenario_can_vary(loop):
    spread = mg.Spread((mg.Vary("scenario.rate.level", mg.Normal(std=2.0)),))
    assert draw(loop, spread, range(8)).scenario.rate.level.shape == (8,)


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: mg.Spread((mg.Vary("device.kzz", mg.Normal(relative=0.1)),)), "`kzz`"),
        (lambda: mg.Spread((mg.Vary("readout.opamp_offset", mg.Normal(relative=0.1)),)), "one number"),
        (lambda: mg.Spread((mg.Vary("readout.opamp_offset.5", mg.Normal(relative=0.1)),)), "`5`"),
        (lambda: mg.Spread((mg.Vary("start.1", mg.Normal(relative=0.1)),)), "relative to a design value of zero"),
        (lambda: mg.Spread((mg.Vary("start.1", mg.Uniform(relative=0.1)),)), "`start.1` must be given in its unit"),
        (lambda: mg.Spread(everywhere=0.005), r"must be a distribution, but is 0.005; .*`Spread.relative\(...\)`"),
        (lambda: mg.Spread(items=mg.Vary("device.kxx", mg.Normal(relative=0.1))), "`items` must be a tuple of `Vary"),
        (lambda: mg.Spread.relative(-0.1), "negative"),
        (lambda: mg.Spread(PAIR, correlation=((1.0, 0.9), (-0.9, 1.0))), r"symmetric, but entry \[0\]\[1\] is 0.9"),
        (lambda: mg.Spread(PAIR, correlation=((1.0, 0.0), (0.0, 4.0))), r"ones on its diagonal, .* \[1\]\[1\] is 4;"),
        (lambda: mg.Spread.relative(0.1, shared=1.0), "`shared` must lie from 0"),
        (lambda: mg.Spread.relative(float("nan")), "negative"),
        (lambda: mg.Spread((mg.Vary("device.kxx", mg.Uniform(relative=-0.1)),)), "negative"),
        (lambda: mg.Spread((mg.Vary("device.kxx", mg.Uniform(relative=0.1, low=1.0)),)), "either `relative`"),
        (lambda: mg.Spread((mg.Vary("device.kxx", mg.Normal(relative=0.1, cut=0.0)),)), "`cut` must be positive"),
        (lambda: mg.Spread((mg.Vary("device.kxx", mg.Uniform()),)), "`relative`"),
        (lambda: mg.Spread((mg.Vary("device.kxx", mg.Uniform(low=2.0, high=1.0)),)), "low <= high"),
        (
            lambda: mg.Spread((mg.Vary("device.kxx", mg.Normal(relative=0.1)),), correlation=((1.0, 0.0), (0.0, 1.0))),
            "1x1",
        ),
        (
            lambda: mg.Spread(
                (mg.Vary("device.kxx", mg.Normal(relative=0.1)), mg.Vary("device.kyy", mg.Normal(relative=0.1))),
                correlation=((1.0, 2.0), (2.0, 1.0)),
            ),
            "no negative eigenvalue",
        ),
    ],
)
def test_bad_spreads_are_one_sentence(loop, make, words):
    with pytest.raises(InputError, match=words):
        draw(loop, make(), range(2))


def test_an_impossible_die_is_drawn_again_and_stays_the_same_die(loop):
    spread = mg.Spread(
        (mg.Vary("device.mass", mg.Normal(relative=0.5)), mg.Vary("device.kxy", mg.Normal(relative=6.0)))
    )
    drawn = draw(loop, spread, range(256))
    mass, kxy = drawn.table.T
    assert 0.1 < np.mean(drawn.redrawn > 0) < 0.6
    assert np.all(mass > 0.0)
    assert np.all(kxy**2 < 63.96 * 95.92)
    first = draw(loop, spread, range(8, 16))
    np.testing.assert_array_equal(first.table, drawn.table[8:16])
    np.testing.assert_array_equal(first.redrawn, drawn.redrawn[8:16])
    for die in np.flatnonzero(drawn.redrawn)[:2]:
        np.testing.assert_array_equal(draw(loop, spread, [die]).table[0], drawn.table[die])
    # What is drawn again follows the same law, cut where no device can be.
    good = mass[drawn.redrawn > 0]
    assert abs(np.mean(good) / 1.8e-7 - 1.0) < 5.0 * 0.5 / np.sqrt(len(good))


@pytest.mark.parametrize("std", [0.15, 0.3])
def test_a_wide_spread_of_either_device_is_drawn(std):
    crossed = stats.norm.cdf(-1.0 / (std * np.hypot(2.6, 1.6)))  # the inner mass above the whole of Table 5.2
    for gyro, share in ((mg.SingleMassGyro.chi2010(), 0.0), (mg.DualMassGyro.chi2010(), crossed)):
        made = mg.ClosedLoop(gyro, READOUT, mg.ExtendedKalmanFilter.for_device(gyro, READOUT), mg.OpenLoop())
        drawn = draw(made, mg.Spread.relative(std), range(512))
        assert np.mean(drawn.redrawn > 0) == pytest.approx(share, abs=0.02)
        assert np.std(drawn.loop.device.dyy / gyro.dyy) == pytest.approx(std, rel=0.1)


def test_dies_that_are_never_possible_are_refused(loop):
    spread = mg.Spread((mg.Vary("device.mass", mg.Uniform(low=-1.0, high=-0.5)),))
    with pytest.raises(InputError, match=r"die 3 impossible.*`cut`.*`mass`"):
        draw(loop, spread, range(3, 8))


def test_numbers_of_one_kind_share_their_causes(loop):
    drawn = draw(loop, mg.Spread.relative(0.1, shared=0.9), range(1024))
    wanted = np.eye(7)
    for kind in (slice(1, 4), slice(4, 7)):
        wanted[kind, kind] = 0.9 + 0.1 * np.eye(3)
    np.testing.assert_allclose(np.corrcoef(drawn.table.T), wanted, atol=0.03)
    assert np.std(drawn.table[:, 2] / 95.92) == pytest.approx(0.1, rel=0.03)
    gyro = mg.SingleMassGyro.from_modes(3e-9, (2e4, 2.0005e4), 5e3)
    made = mg.ClosedLoop(gyro, READOUT, mg.ExtendedKalmanFilter.for_device(gyro, READOUT), mg.OpenLoop())
    apart, matched = (
        np.ptp(mg.mode_frequencies(draw(made, mg.Spread.relative(0.1, shared=share), range(64)).loop.device), axis=-1)
        for share in (0.0, 0.9999)
    )
    assert np.median(matched) < 0.05 * np.median(apart)


def test_a_designed_loop_varies_like_its_device(loop):
    gyro = mg.UncertainGyro(mg.SingleMassGyro.chi2010())
    made = mg.ClosedLoop(gyro, READOUT, mg.ExtendedKalmanFilter.for_device(gyro, READOUT), mg.OpenLoop())
    drawn = draw(made, mg.Spread.relative(0.15), range(16))
    np.testing.assert_array_equal(drawn.table, draw(loop, mg.Spread.relative(0.15), range(16)).table)
    assert drawn.parameters[0] == "device.gyro.mass"
    np.testing.assert_array_equal(drawn.loop.device.gyro.kxx, drawn.table[:, 1])


def test_a_coupling_meant_to_be_zero_varies_and_is_expected_to():
    gyro = mg.SingleMassGyro.from_modes(3e-9, (2e4, 2.1e4), 5e3)
    observer = mg.ExtendedKalmanFilter.for_device(gyro, READOUT)
    made = mg.ClosedLoop(gyro, READOUT, observer, mg.OpenLoop())
    drawn = draw(made, mg.Spread.relative(0.15), range(1024))
    names = [name.removeprefix("device.") for name in drawn.parameters]
    assert names == ["mass", "kxx", "kyy", "kxy", "dxx", "dyy", "dxy"]
    for name, main in (("kxy", ("kxx", "kyy")), ("dxy", ("dxx", "dyy"))):
        size = 0.01 * np.sqrt(float(getattr(gyro, main[0])) * float(getattr(gyro, main[1])))
        values = drawn.table[:, names.index(name)]
        assert np.std(values) == pytest.approx(0.15 * size, rel=0.05)
        assert abs(np.mean(values)) < 0.01 * size
        std = observer.prior.theta_std[gyro.model.index(name)]
        assert float(std) == pytest.approx(0.15 * size / 3e-9, rel=1e-6), "the filter expects what is drawn"


def test_no_coupling_of_the_thesis_is_wider_than_itself(loop):
    prior = mg.design_prior(mg.SingleMassGyro.chi2010())
    k, d = 12.78 / 1.8e-7, 3.6e-7 / 1.8e-7
    place = mg.SingleMassGyro.chi2010().model.index
    for name, value in (("kxy", k), ("dxy", d)):
        assert float(prior.theta_std[place(name)]) == pytest.approx(0.15 * np.sqrt(2.0) * value, rel=1e-12)


class Found:
    """A fit of mass and stiffness whose ratio is held a hundred thousand times better than either."""

    def __init__(self):
        mass, ratio = 1.7e-7, 3.5e8
        slopes = np.array([[1.0, 0.0], [ratio, mass]])  # of (mass, stiffness) by (mass, stiffness over mass)
        self.paths, self.values = ("mass", "kxx"), np.array([mass, mass * ratio])
        self.covariance = slopes @ np.diag([(0.01 * mass) ** 2, (1e-7 * ratio) ** 2]) @ slopes.T
        self.uncertainty = self


def test_dies_of_a_fit_keep_what_it_holds_together():
    loop, scenario = mg.default_study().die(None)
    drawn = mg.Spread.from_fit(Found()).draw(loop, scenario, 0, np.arange(512))
    mass, ratio = drawn.loop.device.mass, drawn.loop.device.kxx / drawn.loop.device.mass
    assert np.mean(mass) == pytest.approx(1.7e-7, rel=1e-3), "about the fit, not the design of the loop"
    assert np.std(mass) == pytest.approx(0.01 * 1.7e-7, rel=0.02)
    assert np.std(ratio) == pytest.approx(1e-7 * 3.5e8, rel=0.05)
    assert abs(np.corrcoef(mass, ratio)[0, 1]) < 0.1


def test_dies_of_a_fit_that_does_not_hold_a_number_are_refused():
    loose = Found()
    loose.covariance[1, 1] = np.inf
    with pytest.raises(mg.InputError, match="do not hold kxx"):
        mg.Spread.from_fit(loose)


def _softened(loop):
    gyro = loop.device.with_effect(mg.effects.CubicStiffness("x", 1e8), mg.effects.CubicStiffness("y", 1e8))
    return mg.ClosedLoop(gyro, READOUT, loop.observer, mg.OpenLoop())


def test_a_number_varies_once(loop):
    one = mg.Vary("device.kxx", mg.Normal(relative=0.1))
    with pytest.raises(InputError, match=r"must name each number once, but names one twice: `device.kxx`; keep one"):
        mg.Spread((one, mg.Vary("device.kyy", mg.Normal(relative=0.1)), one))
    numbered, called = (
        mg.Vary(f"device.effects.{name}.strength", mg.Normal(relative=0.1)) for name in ("0", "cubic_stiffness_x")
    )
    both = mg.Spread((numbered, called))
    with pytest.raises(InputError, match=r"twice: `device.effects.0.strength`, `device.effects.cubic_stiffness_x.str"):
        draw(_softened(loop), both, range(3))
    other = mg.Vary("device.effects.cubic_stiffness_y.strength", mg.Normal(relative=0.1))
    assert draw(_softened(loop), mg.Spread((numbered, other)), range(3)).table.shape == (3, 2)


def test_effects_that_are_known_by_their_labels(loop):
    wrong = mg.Spread((mg.Vary("device.effects.cubic_stiffnes_x.strength", mg.Normal(relative=0.1)),))
    known = r"\(did you mean `cubic_stiffness_x`\? known are cubic_stiffness_x, cubic_stiffness_y\)"
    with pytest.raises(InputError, match=known):
        draw(_softened(loop), wrong, range(3))
