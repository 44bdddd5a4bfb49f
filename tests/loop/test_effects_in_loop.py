"""Effects in the closed loop: beside diffrax and the bench's equations, where they act, and what they leave alone."""

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from harness import Keep, run_kept

import memsgyro_jax as mg
from memsgyro_jax.base.errors import InputError
from memsgyro_jax.device.gyro import SINGLE_MASS, SingleMassGyro
from memsgyro_jax.device.propagate import Exact
from memsgyro_jax.effects import ForceEffect
from memsgyro_jax.effects.evaluation import Acting
from memsgyro_jax.loop import noise
from memsgyro_jax.loop.controllers import DampingCompensation, Tone
from memsgyro_jax.loop.controllers.base import AbstractController
from memsgyro_jax.loop.integrated import Integrated
from memsgyro_jax.loop.loop import ClosedLoop
from memsgyro_jax.loop.observers import Clock, Estimate, ExtendedKalmanFilter
from memsgyro_jax.loop.observers.base import AbstractObserver
from memsgyro_jax.loop.readout import Adc, ChargeAmplifier, DirectReadout
from memsgyro_jax.loop.scenario import AbstractProfile, Constant, Scenario
from memsgyro_jax.loop.with_effects import SampleEffects
from memsgyro_jax.measurement.model import Conditions, Model
from memsgyro_jax.montecarlo.status import LOST
from memsgyro_jax.tuning.tunable import resolved


PERIOD, SAMPLES = 1e-5, 2000
START = (1e-6, 0.3e-6, 0.0, 0.0)
E = mg.effects

# Strengths that move the mass by a part of its swing within 20 ms.
FORCES = (
    E.CubicStiffness("x", 8e11), E.QuadraticStiffness("x", 3e6), E.CrossStiffness(8e11),
    E.ElectrostaticSoftening("y", 2e-3), E.CrossDampingAsymmetry(1e-6), E.QuadraticDamping("x", 5e-5),
    E.SqueezeFilmDamping("y", 1e7), E.DampingStep(0.5, time=0.005), E.ThermalStiffness(-6e-5), E.ThermalDamping(5e-3),
    E.ThermalStiffnessCurvature(-2e-6), E.ThermalDampingCurvature(5e-4),  # at 20 K two thirds and twice of the straight
    E.ParasiticMode("x", 1e-3, omega=2e4, quality=30.0), E.RateOffset(1.0), E.RateScaleError(0.3),
    E.RateBiasDrift(np.full(6, 0.5)), E.AngularAcceleration(1e3), E.Centrifugal(1e5),
)  # fmt: skip


class Turning(AbstractProfile):
    """A rate of 3 rad/s whose slope is said to be 50 rad/s² at every moment."""

    def value(self, time):
        return 3.0 + 50.0 * (time - jax.lax.stop_gradient(time))


AROUND = Scenario(rate=Turning(), temperature=Constant(318.15), bias_voltage=Constant(12.0))


def pushes(time):
    """A force with a part at each mode."""
    return 4e-8 * jnp.sin(2 * jnp.pi * 2893.0 * time), 3e-8 * jnp.cos(2 * jnp.pi * 3758.0 * time)


class Held(AbstractController):
    """`pushes`, held for `split` samples."""

    split: int = eqx.field(static=True)

    def init(self):
        return ()

    def command(self, state, estimate, clock):
        return pushes((clock.sample // self.split) * PERIOD), state


class Blind(AbstractObserver):
    """Sees nothing; the laws under test are those of the sample."""

    model = SINGLE_MASS

    def init(self):
        return jnp.zeros(())

    def update(self, state, measured, force, clock):
        return 0.0 * measured[0]

    def estimate(self, state):
        zero = 0.0 * state
        return Estimate((zero,) * 4, (zero,) * 8, (zero, zero), SINGLE_MASS)


def gyro(*effects):
    return SingleMassGyro(1.8e-7, 63.96, 95.92, 12.78, 3.6e-6, 4.5e-6, 3.6e-7, effects=effects, reference_bias=10.0)


def in_loop(device, split=1, design=None, discretisation=None, dies=0, samples=SAMPLES):
    """Displacements (samples, 2, *dies) of a loop at every hundred-thousandth of a second."""
    loop = ClosedLoop(
        device, DirectReadout(1e5), Blind(), Held(split), START, discretisation=discretisation or Exact(14)
    )
    keep = Keep(lambda sample: sample.motion[:2], (jnp.zeros(()), jnp.zeros(())))
    words = noise.die_words(jax.random.key(0), jnp.asarray(dies))
    beside = None if design is None else eqx.tree_at(lambda made: made.device, loop, design)
    done = run_kept(loop, AROUND, words, jnp.asarray(split / PERIOD), samples, split, keep, beside)
    return np.stack([np.asarray(axis) for axis in done.outputs], axis=1)


@eqx.filter_jit
def on_bench(design, strengths, samples=SAMPLES):
    """The same by the bench's own equations and diffrax, forces held over each sample; dies lead in `strengths`."""

    def die(strengths):
        effects = [eqx.tree_at(lambda e: e.strength, *pair) for pair in zip(design.effects, strengths, strict=True)]
        model = Model(design).with_only(effects)
        here = jnp.asarray([*START, START[0], 0.0])[: model.size]

        def sample(state, number):
            def slope(time, state, force):
                place = Conditions(3.0, 50.0, 0.0, 318.15, 12.0, time, (number + 0.5) / samples)
                return model.derivative(state, force, place)

            found = diffrax.diffeqsolve(
                diffrax.ODETerm(slope), diffrax.Dopri8(), number * PERIOD, (number + 1) * PERIOD, PERIOD, state,
                args=jnp.stack(pushes(number * PERIOD)),
                stepsize_controller=diffrax.PIDController(rtol=1e-12, atol=1e-20),
            )  # fmt: skip
            return found.ys[-1], found.ys[-1][:2]

        return jax.lax.scan(sample, here, jnp.arange(samples))[1]

    return jnp.moveaxis(jax.vmap(die)(strengths), 0, -1)


def with_strengths(device, strengths):
    return eqx.tree_at(lambda g: [effect.strength for effect in g.effects], device, list(strengths))


def alone(effects):
    """Strengths of dies, each of which has one of the effects and the others at zero; dies trail."""
    count = len(effects)
    return [jnp.asarray(e.strength)[..., None] * (np.arange(count) == number) for number, e in enumerate(effects)]


def rms(values):
    return np.sqrt(np.mean(values**2, axis=(0, 1)))


def judge(effects, splits):
    """Size of each effect's own shift, and rms errors of the loop at the period over each of `splits`."""
    design, strengths, dies = gyro(*effects), alone(effects), np.arange(len(effects))
    true = np.asarray(on_bench(design, [jnp.moveaxis(strength, -1, 0) for strength in strengths]))
    none = in_loop(gyro())[..., None]
    runs = [in_loop(with_strengths(design, strengths), split, design, dies=dies) for split in splits]
    return rms(true - none), np.array([rms(run - true) for run in runs])


FEW = (E.CubicStiffness("x", 8e11), E.SqueezeFilmDamping("y", 1e7), E.ParasiticMode("x", 1e-3, quality=30.0))


def test_effects_in_the_loop_follow_the_equations_of_the_bench():
    """20 ms at 100 kHz beside diffrax: a stiffness, a damping, and a state of its own at 20 kHz."""
    shift, errors = judge(FEW, (1, 2))
    assert np.all(errors[0] < 2e-3 * shift)
    assert np.all(np.abs(np.log2(errors[0] / errors[1])[:2] - 2.0) < 0.1)


@pytest.mark.slow
def test_every_smooth_force_effect_is_followed_to_second_order():
    """20 ms at 100 kHz: within 1 % of the effect's own shift, and a sixteenth of that at a quarter of the period."""
    kinds = {type(effect) for effect in FORCES}
    assert kinds == {kind for kind in E.CATALOGUE if issubclass(kind, ForceEffect)} - {E.DryFriction}
    shift, errors = judge(FORCES, (1, 2, 4, 8))
    labels = [effect.label for effect in FORCES]
    assert np.all(errors[0] < 0.01 * shift), dict(zip(labels, errors[0] / shift, strict=True))
    slopes = np.polyfit(np.log2([1, 2, 4, 8]), -np.log2(errors), 1)[0]
    assert np.all(np.abs(slopes - 2.0) < 0.1), dict(zip(labels, slopes, strict=True))


def test_strength_zero_is_absence_bit_for_bit():
    """Of every member: in what it adds to a sample, and in a run of the thesis' loop."""
    absent = gyro(*(effect for effect in E.catalogue() if not isinstance(effect, E.SweepEffect)))
    assert all(np.all(np.asarray(effect.strength) == 0.0) for effect in absent.effects)
    clock, motion, push = Clock(0.0, 0, PERIOD), (1e-6, -2e-7, 1e-3, 2e-3), (3e-9, -2e-9)
    around = AROUND.at(0.0)
    own = (3e-7,) * Acting.of(absent.effects).own_size

    @jax.jit
    def acted(push, motion, volts):
        sample = SampleEffects.of(absent, absent.dynamics(around.inertial), around, push, (1e5, 1e5), clock)
        sample = sample.driven(motion, own)
        shown = [one(volts) for one in sample.shown_at(motion, own)]
        return sample.held, sample.rates(motion, own)[0], shown

    held, rates, shown = jax.tree.map(float, acted(push, motion, (0.123, -0.456)))
    assert tuple(held) == push
    assert tuple(rates) == (0.0, 0.0)
    assert {tuple(one) for one in shown} == {(0.123, -0.456)}

    runs = [mg.simulate(thesis_loop(*e), AROUND, sample_rate=1e5, duration=2e-3) for e in ((), absent.effects)]
    assert np.array_equal(runs[0].motion, runs[1].motion)
    assert np.array_equal(runs[0].theta_estimate, runs[1].theta_estimate)


def thesis_loop(*effects):
    readout = ChargeAmplifier.chi2010()
    observer = ExtendedKalmanFilter.for_device(
        gyro(), readout, known=("kxy", "dxx", "dyy", "dxy", "sigma")
    )  # compiles faster
    return ClosedLoop(gyro(*effects), readout, observer, DampingCompensation(Tone(600.0, 53.95))).sampled_at(100e3)


def test_derivatives_by_strength_are_those_of_finite_differences():
    """Of the displacement at the end of 3 ms, in forward mode, for each of the few."""
    design, strengths = gyro(*FEW), jnp.asarray([effect.strength for effect in FEW])

    @jax.jit
    def end(strengths):
        loop = ClosedLoop(with_strengths(design, strengths), DirectReadout(1e5), Blind(), Held(1), START)

        def sample(state, number):
            clock = Clock(number * PERIOD, number, PERIOD)
            return loop.step(state, AROUND.at(clock.time), (0.0, 0.0), clock)[0], None

        return 1e6 * jnp.stack(jax.lax.scan(sample, loop.init(), jnp.arange(300))[0].motion[:2])

    slopes = np.asarray(jax.jacfwd(end)(strengths)) * np.asarray(strengths)
    moves = 1e-3 * np.diag(strengths)
    # Of fourth order: central differences of this size would hide what is to be seen.
    ends = [[np.asarray(end(strengths + k * move)) for k in (1, -1, 2, -2)] for move in moves]
    finite = [8 * (one - less) - (two - lesser) for one, less, two, lesser in ends]
    finite = np.asarray(finite).T / 12e-3
    assert np.all(np.abs(slopes - finite) < 1e-6 * np.max(np.abs(slopes), axis=0))


@pytest.fixture(scope="module")
def varied():
    """A sweep in which strengths differ, by label and by number, and some dies' springs turn over."""
    spread = mg.Spread(
        (
            mg.Vary("device.kxx", mg.Normal(relative=0.05)),
            mg.Vary("device.effects.cubic_stiffness_x.strength", mg.Uniform(low=-2e14, high=8e11)),
            mg.Vary("device.effects.1.strength", mg.Uniform(low=0.0, high=1e7)),
        )
    )

    def run(dies, chunk):
        lot = mg.sweep(thesis_loop(*FEW), spread, dies=dies, chunk=chunk, duration=0.002, bound_dies=0)
        return lot.to_xarray()

    return run


def test_a_die_with_effects_is_the_same_die_in_any_chunk_and_its_loss_its_own(varied):
    many, few = varied(24, 8), varied(10, 3)
    for name in few.data_vars:
        if "die" in few[name].dims:
            assert np.array_equal(few[name].values, many[name].isel(die=slice(10)).values, equal_nan=True), name
    status = many["status"].values
    assert 0 < np.sum(status == LOST) < 24
    assert np.all(np.isfinite(many["rate_error_end"].values) == (status != LOST))


class Table(ForceEffect):
    """A restoring force read from a table."""

    name, unit, law = "table", "N", "F = −s·f(q)"
    strength: jax.Array = E.strength()
    values: jax.Array = eqx.field(converter=jnp.asarray, default=(1.0, 0.5, 0.0, -0.5))

    def force(self, now):
        places = jnp.linspace(-2e-6, 2e-6, 4)
        return self.along(now, self.strength * jnp.interp(now.displacement[0], places, self.values))


def test_a_table_of_as_many_rows_as_dies_is_not_one_number_per_die():
    design, strengths = gyro(Table(1e-9)), jnp.asarray([0.0, 1e-9, 2e-9, 3e-9])
    dies = in_loop(with_strengths(design, [strengths]), 1, design, dies=np.arange(4), samples=50)
    one = in_loop(gyro(Table(2e-9)), samples=50)
    np.testing.assert_allclose(dies[..., 2], one, rtol=1e-12, atol=1e-20)
    assert np.max(np.abs(dies[..., 3] - dies[..., 0])) > 1e-12


@pytest.mark.slow
def test_the_reference_follows_the_exact_step_and_loses_a_die_alone():
    """A spring that turns over sends its die off to infinity within a sample; the die beside it goes on."""
    design = gyro(FEW[0])
    dies = in_loop(
        with_strengths(design, [jnp.asarray([0.0, -1e30])]), 1, design, Integrated(steps=64), np.arange(2), samples=50
    )
    np.testing.assert_allclose(dies[..., 0], in_loop(gyro(), samples=50), atol=1e-17)
    assert np.all(dies[1:, :, 1] == dies[0, :, 1]) or np.all(np.isnan(dies[1:, :, 1]))


def one_sample(device, readout, discretisation=None):
    loop = ClosedLoop(device, readout, Blind(), Held(1), START, discretisation=discretisation or Exact(14))
    clock = Clock(jnp.asarray(7 * PERIOD), jnp.asarray(7), PERIOD)
    return loop.step(loop.init(), AROUND.at(clock.time), (1.5, -0.5), clock)[1], pushes(7 * PERIOD)


def moved(force, time):
    """Where the base device is after `time` under a held force."""
    dynamics = gyro().dynamics(AROUND.at(0.0).inertial)
    push = tuple(g * f for g, f in zip(dynamics.gain, force, strict=True))
    return Exact(14).advance(START, push, dynamics.stiffness, dynamics.velocity, time)


def test_drive_effects_act_between_command_and_electrode():
    device = gyro(E.ForceMisalignment("x", "y", 0.1), E.DriveNonlinearity("x", 2e6))
    sample, (x, y) = one_sample(device, DirectReadout(1e5))
    assert tuple(sample.force) == (x, y)
    given = x + 2e6 * x**2  # the misalignment is of the electrodes, whatever drives them
    want = moved((given, y + 0.1 * given), PERIOD)
    np.testing.assert_allclose(np.array(sample.motion), np.array(want), rtol=1e-12)


def test_readout_effects_act_between_motion_and_volts_and_a_converter_behind_the_noise():
    late, leak, bend = 3e-7, 1e3, 1e4
    readout = DirectReadout(1e5, 0.01, 1e-4, Adc(10.0, 48))
    effects = (E.ReadoutDelay(late), E.PickoffNonlinearity("x", bend), E.ElectricalFeedthrough("x", "y", leak))
    sample, force = one_sample(gyro(*effects), readout)
    here, then = (np.array(moved(force, time)[:2]) for time in (PERIOD, PERIOD - late))
    want = 1e5 * then + 0.01 + np.array([1e5 * bend * here[0] ** 2, leak * force[0]])
    want += np.array([1.5, -0.5]) * 1e-4 * np.sqrt(0.5 / PERIOD)
    np.testing.assert_allclose(np.array(sample.volts), want, rtol=1e-7)
    limit = float(np.min(want)) + 1e-3
    clipped, _ = one_sample(gyro(*effects, E.AdcSaturation(1.0 / limit)), readout)
    np.testing.assert_allclose(np.array(clipped.volts), np.minimum(want, limit), rtol=1e-7)


def test_a_loop_refuses_effects_that_mean_nothing_in_it():
    """A sweep's own effect, a pick-off's on a velocity, a state too fast for the samples."""
    with pytest.raises(InputError, match="takes no frequency sweep"):
        ClosedLoop(gyro(E.FiniteSweepRate(1.0)), DirectReadout(1e5), Blind(), Held(1))
    with pytest.raises(InputError, match=r"must show displacement, .*`readout_delay`; leave that out with"):
        ClosedLoop(gyro(E.ReadoutDelay(1e-7)), DirectReadout.of_velocity(1.0), Blind(), Held(1))
    fast = gyro(E.ParasiticMode("x", 1e-3, omega=2 * np.pi * 60e3))
    with pytest.raises(InputError, match="`parasitic_mode x`"):
        ClosedLoop(fast, DirectReadout(1e5), Blind(), Held(1)).sampled_at(100e3)


class _ForBoth(ForceEffect):
    """What a newcomer writes: a number where one for each axis belongs."""

    name, unit, law = "for_both", "N", "F = s"
    strength: jax.Array = mg.effects.strength()

    def force(self, now):
        return -self.strength * now.displacement[0]


def test_a_force_for_no_axis_is_refused_where_it_would_act_on_both():
    loop = ClosedLoop(gyro(_ForBoth(1.0)), DirectReadout(1e5), Blind(), Held(1))
    with pytest.raises(
        InputError, match=r"`for_both`: method `force` must return an array of shape \(2,\), but returns one of \(\)"
    ):
        mg.simulate(loop, 1.0, sample_rate=100e3, duration=1e-4)


def test_an_effect_is_reached_by_its_label_and_its_place():
    loop = thesis_loop(E.CubicStiffness("x", 8e11), E.ParasiticMode("x", 1e-3))
    named = mg.free({"device.effects.parasitic_mode_x.quality": (10.0, 1e3), "device.effects.0.strength": (0.0, 1e12)})
    assert resolved(loop, named, 1e5, 0.1).paths == ("device.effects.0.strength", "device.effects.1.quality")
    assert loop.device.effects.cubic_stiffness_x is loop.device.effects[0]


def test_unequal_cross_damping_is_the_same_on_the_bench():
    """The bench makes an effect of what the loop has in its equations; sign and size agree."""
    unequal = SingleMassGyro(1.8e-7, 63.96, 95.92, 12.78, 3.6e-6, 4.5e-6, 3.6e-7, dyx=9e-7)
    matrix = np.asarray(Model(unequal).linear(Conditions(rate=2.0))[0])[2:]
    true = unequal.dynamics(Conditions(rate=2.0).inertial)
    np.testing.assert_allclose(-matrix, np.hstack([np.array(true.stiffness), np.array(true.velocity)]), rtol=1e-12)
    assert Model(unequal).physical().effects.cross_damping_asymmetry.strength == pytest.approx(-5.4e-7)
