"""Designed motion: the closed form is the information bound of the run, limits hold, the filter reaches the bound."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import matplotlib as mpl
import numpy as np
import pytest
import scipy.linalg

import memsgyro_jax as mg
from memsgyro_jax.base.errors import InputError
from memsgyro_jax.base.linalg import cholesky
from memsgyro_jax.loop import engine, noise
from memsgyro_jax.loop.scenario import as_scenario
from memsgyro_jax.motion.design import _drawn
from memsgyro_jax.motion.information import Tones, geometric, rate_variance, sensitivities


mpl.use("agg")

GYRO = mg.SingleMassGyro.chi2010()
NONE = mg.ModelErrors.none()
rows_seen = eqx.filter_jit(sensitivities)
SETTINGS = {"known": ("sigma",), "starts": 6, "steps": 100}


@pytest.fixture(scope="module")
def design() -> mg.MotionDesign:
    """Two tones that may move both axes, for all errors; the nominal one beside it."""
    return mg.design_motion(GYRO, tones=2, **SETTINGS)


@pytest.fixture(scope="module")
def own_axis() -> mg.MotionDesign:
    return mg.design_motion(GYRO, tones=2, own_axis=True, errors=NONE, known=("sigma",), starts=3, steps=60)


def forced(design: mg.MotionDesign) -> mg.ClosedLoop:
    """The design's forces on the design device: the motion is the design from the first sample to the last."""
    made = design.setting
    observer = mg.ExtendedKalmanFilter.for_device(made.gyro, made.readout)
    return mg.ClosedLoop(made.gyro, made.readout, observer, design.open_loop, design.start)


def test_the_closed_form_is_the_information_bound_of_the_run(own_axis):
    """With a third tone, so that the mass is found too: every unknown."""
    made = dataclasses.replace(own_axis, setting=dataclasses.replace(own_axis.setting, known=(), duration=0.02))
    made = made.with_tones([3600.0, 600.0, 3050.0], [[0.8e-6, 0.1e-6j], [0.1e-6, 0.1e-6], [0.0, 0.7e-6]])
    run = {"sample_rate": 100e3, "duration": 0.02, "windows": 1}
    want = mg.information_bound(forced(made), 1.0, **run)
    assert made.bound() == pytest.approx(want.rate_std[-1], rel=1e-8)
    moved = Tones(2.0 * np.pi * made.frequency, made.amplitude)
    rows = rows_seen(made.setting.plant(), moved, 1e-5, 2000, (0, 1))

    def variance(index):  # each unknown in the rate's place: one program for all
        own = jnp.roll(rows[:, :14], -index, axis=1)
        return rate_variance(jnp.concatenate([own, rows[:, 14:]], axis=1), jnp.ones(14), 0, jnp.zeros(5))

    variances = jax.jit(jax.vmap(variance))(jnp.arange(14))
    assert np.sqrt(variances) == pytest.approx(want.std[-1], rel=1e-7)


def test_errors_of_the_model_enter_as_finite_differences_of_a_simulation(own_axis):
    """The device stepped by SciPy's matrix exponential: unequal cross damping, gains of the force, a late read-out."""
    samples, h, made = 300, 1e-5, own_axis.setting
    middle = (np.arange(samples)[:, None] + 0.5) * h
    force = np.real(np.exp(2j * np.pi * own_axis.frequency * middle) @ own_axis.force)
    dynamics = GYRO.dynamics(mg.Scenario(rate=mg.Constant(1.0)).at(0.0).inertial)

    def volts(change):
        matrix = np.zeros((6, 6))
        matrix[:2, 2:4], matrix[2:4, :2] = np.eye(2), -np.asarray(dynamics.stiffness)
        matrix[2:4, 2:4] = -np.asarray(dynamics.velocity) + 0.5 * change[0] * np.array([[0.0, 1.0], [-1.0, 0.0]])
        matrix[2:4, 4:] = np.diag(np.asarray(dynamics.gain) * (1.0 + change[1:3]))
        step = scipy.linalg.expm(h * matrix)
        state, seen = np.array(own_axis.start), []
        for push in force:
            state = step[:4, :4] @ state + step[:4, 4:] @ push
            seen.append(state[:2] - change[3:] * state[2:])
        return np.asarray(seen) * np.asarray([float(s) for s in made.readout.scale])

    sizes = np.array([1e-2, 1e-3, 1e-3, 1e-7, 1e-7])
    want = [(volts(d) - volts(-d)).ravel() / (2.0 * s) for d, s in zip(np.diag(sizes), sizes, strict=True)]
    want = np.asarray(want).T / float(made.readout.noise_std(h)[0])
    moved = Tones(2.0 * np.pi * own_axis.frequency, own_axis.amplitude)
    got = np.asarray(rows_seen(made.plant(), moved, h, samples, (0, 1)))[:, -5:]
    size = np.linalg.norm(want, axis=0)
    np.testing.assert_allclose(got.T @ got / size / size[:, None], want.T @ want / size / size[:, None], atol=1e-6)


def test_two_frequencies_of_their_own_axis_reach_the_known_optimum(own_axis):
    assert np.degrees(own_axis.bound()) < 1.0
    assert own_axis.nominal is None
    assert np.all(np.count_nonzero(np.abs(own_axis.amplitude) > 1e-12, axis=1) == 1)


def test_the_design_counts_with_what_the_model_omits(design, own_axis):
    """10 % of unequal cross damping are 2.86 deg/s by themselves; a delay shows in a design that omits it only."""
    assert np.degrees(design.nominal.bound()) < 0.03
    floor = 0.1 * 3.6e-7 / (4.0 * 1.8e-7)
    assert floor < design.bound() < 1.01 * floor
    assert np.degrees(own_axis.bound(mg.ModelErrors())) > 100.0
    for errors in (mg.ModelErrors(0.1, 0.01, 0.0), mg.ModelErrors(0.0, 0.01, 1e-7)):
        assert design.nominal.bound(errors) >= design.nominal.bound() * (1.0 - 1e-9)


def test_limits_hold(design):
    assert np.all(np.sum(np.abs(design.amplitude), axis=0) <= 1e-6 * (1.0 + 1e-9))
    weak = mg.design_motion(
        GYRO, tones=2, force=20e-6, displacement=0.9e-6, errors=NONE, band=(2500.0, 4500.0), **SETTINGS
    )
    assert np.all(np.sum(np.abs(weak.force), axis=0) <= 20e-6 * (1.0 + 1e-9))
    assert np.all(np.sum(np.abs(weak.amplitude), axis=0) <= 0.9e-6 * (1.0 + 1e-9))
    assert np.max(np.sum(np.abs(weak.force), axis=0)) > 19.99e-6, "the limit is used"
    assert np.all((weak.frequency > 2500.0) & (weak.frequency < 4500.0))


def test_the_gyro_comes_to_move_as_designed(design):
    """From a start that is off by 0.1 µm: the controller, that knows the device but not the motion, settles it."""
    nominal = design.nominal
    loop = nominal.closed_loop()
    loop = dataclasses.replace(loop, start=(loop.start[0] + 0.1e-6, *loop.start[1:]))
    trace = mg.simulate(loop, 1.0, sample_rate=100e3, duration=0.01, seed=1)
    phase = 2.0 * np.pi * nominal.frequency * trace.time[:, None]
    off = np.max(np.abs(trace.motion[:, :2] - np.real(np.exp(1j * phase) @ nominal.amplitude)), axis=1)
    assert np.max(off[:100]) > 0.05e-6
    assert np.max(off[-100:]) < 0.01e-6
    assert np.mean(trace.nis[500:]) == pytest.approx(2.0, abs=0.4)


def test_settling_is_not_negative():
    with pytest.raises(InputError, match="`settling` must be finite and not negative"):
        mg.DesignedMotion(settling=-1.0)


def test_a_design_is_aimed_at_another_die(design):
    other = mg.SingleMassGyro(2.0e-7, 60.0, 99.0, 11.0, 3.9e-6, 4.2e-6, 3e-7)
    nominal = design.nominal
    aimed = nominal.aimed_at(other)
    own = mg.mode_frequencies(other) / mg.mode_frequencies(GYRO)
    np.testing.assert_allclose(aimed.frequency / nominal.frequency, own, rtol=1e-3)
    assert aimed.bound() < 2.0 * nominal.bound()
    assert nominal.bound(gyro=other) > 5.0 * aimed.bound(), "frozen, it misses the modes"
    again = aimed.aimed_at(GYRO)
    np.testing.assert_allclose(again.frequency, nominal.frequency, rtol=1e-9)
    assert np.all(np.sum(np.abs(aimed.amplitude), axis=0) <= 1e-6 * (1.0 + 1e-9))


@pytest.mark.slow
def test_the_loop_claims_no_more_than_the_design_assumed(design):
    """Dies with the errors of the model: unequal cross damping, which no filter tells from a rate, gains and delays."""
    asymmetry, gain, _, delay, _ = (float(std) for std in design.errors.std(GYRO))
    paths = {"device.gyro.cross_damping_asymmetry": asymmetry * float(GYRO.mass), "device.gain.0": gain}
    paths |= {"device.gain.1": gain}
    for axis in (0, 1):  # what acts, and what the estimate is held against, are one number
        paths |= {f"device.delay.{axis}": delay, f"readout.delay.{axis}": delay}
    correlation = np.eye(7)
    correlation[[3, 4, 5, 6], [4, 3, 6, 5]] = 1.0 - 1e-12
    items = tuple(mg.Vary(path, mg.Normal(std=std)) for path, std in paths.items())
    spread = mg.Spread(items, correlation=tuple(map(tuple, correlation)))
    lot = mg.sweep(design.closed_loop(), spread, 1.0, dies=64, bound_dies=0)
    claimed, error = lot.data["rate_std_end"].values, lot.data["rate_error_end"].values
    assert claimed == pytest.approx(design.bound(), rel=0.05)
    assert np.sqrt(np.mean(error**2)) == pytest.approx(design.bound(), rel=0.35)
    assert np.mean((error / claimed) ** 2) == pytest.approx(1.0, abs=3.0 * np.sqrt(2.0 / 64.0))
    assert np.median(lot.data["nees_end"].values) < 1.2 * lot.summary.states
    assert len(lot.summary.divergence.dies) <= 2, "one in 64 did not bear being linearised, and is named"


def test_errors_of_zero_are_known():
    errors = {"cross_damping": 0.1, "force_gain": 0.0, "delay": 0.0}
    for gyro, gain in ((GYRO, ("gain_split",)), (mg.DualMassGyro.chi2010(), ())):
        made, usual = mg.UncertainGyro(gyro), mg.design_prior(gyro)
        prior, known = made.prior(usual, mg.ModelErrors(**errors), ())
        assert known == (*gain, "delay_x", "delay_y")
        std = dict(zip(made.model.names, prior.theta_std, strict=True))
        assert std["cross_damping_asymmetry"] == pytest.approx(mg.ModelErrors().std(gyro)[0])
        assert prior.theta_std[: len(usual.theta)] == usual.theta_std
    masses = ("sigma_x", "sigma_y")
    prior, known = made.prior(usual, mg.ModelErrors(**errors | {"force_gain": 0.01}), masses)
    assert known == ("delay_x", "delay_y"), "an error of the gain hides a known mass"
    found = [prior.theta_std[made.model.index(name)] / prior.theta[made.model.index(name)] for name in masses]
    assert found == pytest.approx([0.01, 0.01])
    unequal = mg.SingleMassGyro(1.8e-7, 64.0, 96.0, 12.8, 3.6e-6, 4.5e-6, 3e-7, dyx=4e-7)
    made = mg.UncertainGyro(unequal)
    assert made.coefficients(1.0)[made.model.index("cross_damping_asymmetry")] == pytest.approx(1e-7 / 1.8e-7)


@pytest.mark.slow
def test_a_spread_is_designed_for(design):
    """Dies that all move alike: in the mean they tell more than in the motion that is best for the design device."""
    spread = mg.Spread.relative(0.1)
    lot = mg.design_motion(GYRO, tones=2, errors=NONE, spread=spread, dies=3, aiming=False, **SETTINGS)
    dies = _drawn(lot.setting, spread, 3, 0)
    mean = lambda made: np.mean([np.log(made.bound(NONE, die)) for die in dies])  # noqa: E731
    assert mean(lot) < mean(design.nominal) - 0.05


@pytest.mark.slow
def test_the_filter_finds_gains_and_delays_and_comes_near_the_bound():
    dies, design = 128, mg.design_motion(GYRO, errors=mg.ModelErrors(0.0, 0.01, 1e-7))
    loop = design.closed_loop().sampled_at(100e3)
    draw = np.random.default_rng(5).standard_normal((4, dies))
    gain, delay = tuple(0.01 * draw[:2]), tuple(1e-7 * draw[2:])
    batch = eqx.tree_at(lambda l: (l.device.gain, l.device.delay, l.readout.delay), loop, (gain, delay, delay))  # noqa: E741
    words = noise.die_words(jax.random.key(1), jnp.arange(dies))
    end = eqx.filter_jit(engine.run)(batch, as_scenario(1.0), words, 1e-5, 100, 100, _Nothing(), loop)
    assert bool(np.all(end.alive))
    estimate = loop.observer.estimate(end.state.observer)
    names = loop.observer.model.names
    found = np.asarray(estimate.theta[names.index("delay_x")] - estimate.theta[names.index("delay_y")])
    assert np.std(found - (delay[0] - delay[1])) < 0.2e-7, "of 1.4e-7 that were drawn"
    assert np.sqrt(np.mean((np.asarray(estimate.rate) - 1.0) ** 2)) < 1.5 * design.bound()


class _Nothing(engine.AbstractRecorder):
    def init(self):
        return ()

    def sample(self, memory, sample):
        return memory

    def block(self, memory):
        return memory, memory


def test_a_design_prints_itself_and_becomes_a_dataset_and_a_picture(design):
    text = repr(design)
    assert "this design" in text
    assert "nominal design" in text
    assert "cross damping ± 10 %, force gain ± 1 %, delay ± 0.1 µs" in text
    assert "gains nothing over the nominal design under them (2.8649 against 2.8649 deg/s)" in text
    assert "cross damping by itself is 2.8648 deg/s" in text
    data = design.to_xarray()
    assert data["bound"].sel(design="this design").values[-1] == pytest.approx(design.bound())
    assert data["displacement"].dims == ("tone", "axis")
    assert design.plot().get_ylabel() == "displacement [µm]"
    mpl.pyplot.close("all")


def test_parts_of_the_closed_form():
    exponent = np.array([0.0, 1e-9j, 1e-4j - 1e-5, 0.3j, 0.2j - 0.01])
    want = [np.sum(np.exp(e * np.arange(1, 501))) for e in exponent]
    np.testing.assert_allclose(geometric(jnp.asarray(exponent), 500), want, rtol=1e-10)
    root = np.random.default_rng(1).normal(size=(6, 6))
    matrix = root @ root.T
    np.testing.assert_allclose(cholesky(jnp.asarray(matrix)), np.linalg.cholesky(matrix), rtol=1e-9)
    twice = np.kron(np.ones((2, 2)), matrix)
    made = np.asarray(cholesky(jnp.asarray(twice)))
    np.testing.assert_allclose(made @ made.T, twice, rtol=1e-9)


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        ({"tones": 0}, "`tones` must be at least 1, but 0"),
        ({"starts": 0}, "`starts` must be at least 1"),
        ({"displacement": 0.0}, "`displacement` must be positive"),
        ({"force": -1.0}, "`force` must be positive, but -1"),
        ({"band": (4000.0, 3000.0)}, "`band` must be two rising frequencies below half the sample rate"),
        ({"band": (4000.0, 60e3)}, "`band` must be two rising frequencies"),
        ({"known": ("mass",)}, "`known` must name some of x, y, .*sigma, but holds `mass`"),
        ({"known": ("rate",)}, "but holds `rate`"),
        ({"sample_rate": 5e3, "band": (1e3, 2e3)}, "`sample_rate` must exceed twice"),
        ({"readout": mg.ChargeAmplifier.chi2010(noise_density=0.0)}, "must have noise on both axes"),
        ({"tones": 1, "errors": NONE, **SETTINGS}, "`tones` must be enough .* 1 leave the rate undeter"),
    ],
)
def test_what_cannot_be_is_one_sentence(arguments, says):
    with pytest.raises(InputError, match=says):
        mg.design_motion(GYRO, **arguments)


@pytest.mark.parametrize("name", ["cross_damping", "force_gain", "delay"])
def test_errors_are_not_negative(name):
    with pytest.raises(InputError, match=f"`{name}` must be finite and not negative"):
        mg.ModelErrors(**{name: -0.1})


def test_a_device_that_does_not_swing_is_refused():
    stiff = mg.SingleMassGyro(1.8e-7, 63.96, 95.92, 0.0, 3.6e-2, 4.5e-6, 0.0)
    with pytest.raises(InputError, match="`gyro` must have two damped resonances"):
        mg.design_motion(stiff)


def test_a_delayed_readout_must_show_displacement():
    with pytest.raises(InputError, match="`inner` must be a displacement read-out"):
        mg.Delayed(mg.DirectReadout.of_velocity(1.0, 1e-9), 1e-7)


def test_an_uncertain_gyro_without_errors_is_the_gyro():
    for gyro in (GYRO, mg.DualMassGyro.chi2010()):
        made = mg.UncertainGyro(gyro)
        inertial = mg.Scenario(rate=mg.Constant(1.0)).at(0.0).inertial
        assert made.dynamics(inertial) == gyro.dynamics(inertial)
        assert made.coefficients(1.0)[: len(gyro.model.names)] == gyro.coefficients(1.0)
        assert made.model.names[-2:] == ("delay_x", "delay_y")
        off = mg.UncertainGyro(gyro, (0.02, -0.01))
        np.testing.assert_allclose(
            off.model.assemble(off.coefficients(1.0)).gain, off.dynamics(inertial).gain, rtol=1e-12
        )
