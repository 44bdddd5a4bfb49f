"""Ranks, singular values and null directions against a 60-digit computation, theory and the information bound."""

import equinox as eqx
import jax.numpy as jnp
import mpmath
import numpy as np
import pytest

from memsgyro_jax.base.errors import InputError
from memsgyro_jax.device.gyro import DUAL_MASS, SINGLE_MASS, SingleMassGyro
from memsgyro_jax.loop.bound import CROSS_DAMPING_ASYMMETRY, information_bound
from memsgyro_jax.loop.controllers import DampingCompensation, OpenLoop, Tone
from memsgyro_jax.loop.loop import ClosedLoop
from memsgyro_jax.loop.observability import observability, observability_matrix
from memsgyro_jax.loop.observers import ExtendedKalmanFilter
from memsgyro_jax.loop.readout import DirectReadout
from memsgyro_jax.loop.scenario import as_scenario
from memsgyro_jax.loop.trace import simulate
from memsgyro_jax.montecarlo.batch import Plan
from memsgyro_jax.montecarlo.divergence import divergence_of


LOW, HIGH, TONE = 3000.0, 5000.0, 500.0  # Hz, thesis 4.1.1
TIME = np.array([0.11e-3, 0.37e-3])
ONE = ({LOW: (1.0, 0.0)}, {LOW: (1.0, 0.0)})  # x and y as {frequency: (sine, cosine)} in µm
BOTH = ({LOW: (1.0, 0.0), HIGH: (0.0, 1.0)}, {LOW: (0.0, 1.0), HIGH: (0.0, 1.0)})
APART = ({LOW: (1.0, 0.0)}, {HIGH: (1.0, 0.0)})


def fed_back(motion, gains=((0.3, 0.7), (0.3, 0.7)), tone=0.0, constant=0.0):
    """Forces of a state feedback, in the same form, in µN for µm."""
    forces = []
    for row in gains:
        parts = {TONE: (tone, 0.0), 0.0: (0.0, constant)}
        for gain, axis in zip(row, motion, strict=True):
            for frequency, pair in axis.items():
                old = parts.get(frequency, (0.0, 0.0))
                parts[frequency] = tuple(a + gain * b for a, b in zip(old, pair, strict=True))
        forces.append(parts)
    return tuple(forces)


def formula(parts, unit=1e-6):
    """The sum as a function that JAX differentiates."""

    def at(time):
        return tuple(
            unit
            * sum(s * jnp.sin(2 * jnp.pi * f * time) + c * jnp.cos(2 * jnp.pi * f * time) for f, (s, c) in axis.items())
            for axis in parts
        )

    return at


def over_largest(parts, time):
    """A motion or forces over their largest value at the instants."""
    largest = max(abs(float(v)) for v in np.stack(formula(parts, 1.0)(jnp.asarray(time))).ravel())
    return tuple({f: tuple(v / largest for v in pair) for f, pair in axis.items()} for axis in parts)


def sixty_digits(coefficients, motion, force, time, *, velocity, unit_of_time=4000.0):
    """Singular values of the same matrix from written-out derivatives with mpmath, and rows that span its null space:
    the values there are 1e-40 of the largest and less.
    """
    with mpmath.workdps(60):
        omega, time = 2 * mpmath.pi * unit_of_time, mpmath.mpf(float(time))

        def derivative(parts, order):
            total = mpmath.mpf(0)
            for frequency, (s, c) in parts.items():
                w = 2 * mpmath.pi * frequency
                angle = w * time + order * mpmath.pi / 2
                total += (w / omega) ** order * (s * mpmath.sin(angle) + c * mpmath.cos(angle))
            return total

        count = len(coefficients)
        rows = []
        for k in range(count):
            axis, order = k % 2, k // 2 + velocity
            signals = [derivative(parts, order) for parts in motion]
            signals += [derivative(parts, order + 1) for parts in motion] + [
                derivative(parts, order) for parts in force
            ]
            row = [
                sum(mpmath.mpf(t.factor) * signals[t.signal] for t in c.terms if t.axis == axis) for c in coefficients
            ]
            rows.append(row)
        return decomposed(rows)


def decomposed(rows):
    """Singular values of a matrix of mpmath's numbers, and rows that span its null space."""
    _, singular, right = mpmath.svd_r(mpmath.matrix(rows))
    singular = list(singular)
    rank = sum(value > mpmath.mpf(10) ** -40 * singular[0] for value in singular)
    null = [[float(right[i, j]) for j in range(right.cols)] for i in range(rank, right.rows)]
    return np.array(list(map(float, singular))), np.array(null).reshape(-1, right.cols)


def has_null_space(found, null):
    """Whether the directions named by `found` are those of 60 digits."""
    named = [[direction.get(name, 0.0) for name in found.names] / found.scale for direction in found.null]
    for direction in named:
        inside = null.T @ (null @ direction)
        np.testing.assert_allclose(direction, inside, atol=2e-3 * np.max(np.abs(direction)))  # parts below 1e-3 unnamed
    return len(named) == len(null)


def matrix(model, motion, force=({}, {}), *, velocity=True, time=TIME, **options):
    return observability_matrix(
        model, formula(motion), formula(force), time, frequency=4000.0, velocity=velocity, **options
    )


@pytest.mark.parametrize("velocity", [True, False])
@pytest.mark.parametrize("model", [SINGLE_MASS, DUAL_MASS])
def test_singular_values_are_those_of_sixty_digits(model, velocity):
    force = fed_back(BOTH, tone=0.4)
    found = matrix(model, BOTH, force, velocity=velocity)
    scaled, pushes = over_largest(BOTH, TIME), over_largest(force, TIME)
    for place, instant in enumerate(TIME):
        exact, null = sixty_digits(model.coefficients, scaled, pushes, instant, velocity=velocity)
        assert not len(null)
        np.testing.assert_allclose(found.singular_values[place], exact, rtol=1e-9, atol=1e-12 * exact[0])


@pytest.mark.slow
def test_ranks_of_thesis_4_1_to_4_3():
    known, both = {"known": ("sigma",)}, {"known": ("sigma",), "also": (CROSS_DAMPING_ASYMMETRY,)}
    assert set(matrix(SINGLE_MASS, ONE, **known).rank) == {4}
    assert set(matrix(SINGLE_MASS, BOTH, **known).rank) == {7}
    unequal = matrix(SINGLE_MASS, BOTH, **both)
    assert set(unequal.rank) == {7}
    assert unequal.null == ({"rate": pytest.approx(-0.25), "cross_damping_asymmetry": 1.0},)
    seven = tuple(c for c in SINGLE_MASS.coefficients if c.name != "sigma")
    for asked, motion, options in ((seven, ONE, known), ((*seven, CROSS_DAMPING_ASYMMETRY), BOTH, both)):
        _, null = sixty_digits(asked, motion, ({}, {}), TIME[0], velocity=True)
        assert has_null_space(matrix(SINGLE_MASS, motion, time=TIME[:1], **options), null)
    symmetric = ((0.3, 0.5), (0.5, 0.7))
    for model, ranks in ((SINGLE_MASS, (4, 7, 8, 8)), (DUAL_MASS, (4, 8, 8, 10))):
        forces = fed_back(ONE), fed_back(APART, symmetric), fed_back(APART), fed_back(APART, tone=1.0)
        motions = ONE, APART, APART, APART
        found = [matrix(model, *pair) for pair in zip(motions, forces, strict=True)]
        assert tuple(int(f.rank.min()) for f in found) == tuple(int(f.rank.max()) for f in found) == ranks
        for motion, force in zip(motions, forces, strict=True):
            scaled = over_largest(motion, TIME[:1]), over_largest(force, TIME[:1])
            _, null = sixty_digits(model.coefficients, *scaled, TIME[0], velocity=True)
            assert has_null_space(matrix(model, motion, force, time=TIME[:1]), null)
    # A symmetric feedback is a change of the springs: the mass is known up to it.
    (direction,) = matrix(SINGLE_MASS, APART, fed_back(APART, symmetric)).null
    assert direction["kxx"] / direction["sigma"] == pytest.approx(0.3)
    assert direction["kyy"] / direction["sigma"] == pytest.approx(0.7)


def test_a_constant_force_tells_the_mass_by_displacement_only():
    force = fed_back(APART, ((0.3, 0.5), (0.5, 0.7)), constant=1.0)
    assert set(matrix(SINGLE_MASS, APART, force, velocity=False).rank) == {8}
    assert set(matrix(SINGLE_MASS, APART, force, velocity=True).rank) == {7}


def test_units_do_not_decide():
    force = fed_back(BOTH, tone=0.4)
    small = observability_matrix(
        SINGLE_MASS, formula(BOTH, 1e-9), formula(force, 1e-12), TIME, frequency=4000.0, velocity=True
    )
    np.testing.assert_allclose(small.singular_values, matrix(SINGLE_MASS, BOTH, force).singular_values, rtol=1e-9)
    slow = tuple({f / 100: pair for f, pair in axis.items()} for axis in BOTH)
    later = observability_matrix(
        SINGLE_MASS, formula(slow), formula(({}, {})), 100 * TIME, frequency=40.0, velocity=True, known=("sigma",)
    )
    fast = matrix(SINGLE_MASS, BOTH, known=("sigma",))
    np.testing.assert_allclose(later.singular_values, fast.singular_values, rtol=1e-9)


@pytest.fixture(scope="module")
def loop() -> ClosedLoop:
    gyro, readout = SingleMassGyro.chi2010(), DirectReadout(1e5, noise_density=(1e-6, 1e-6))
    known = tuple(
        name for name in gyro.model.names if name != "rate"
    )  # only its commands count, and it compiles faster
    observer = ExtendedKalmanFilter.for_device(gyro, readout, known=known)
    return ClosedLoop(gyro, readout, observer, DampingCompensation(tones=Tone(600.0, 53.95)))


@pytest.mark.slow
def test_a_run_leaves_what_the_bound_calls_degenerate(loop):
    found = observability(loop, duration=3e-3, also=(CROSS_DAMPING_ASYMMETRY,))
    bound = information_bound(loop, duration=3e-3, also=(CROSS_DAMPING_ASYMMETRY,))
    assert set(found.rank) == {14}
    (mine,), (theirs,) = found.null, bound.degenerate
    assert set(mine) == set(theirs) == {"rate", "cross_damping_asymmetry"}
    assert mine["rate"] / mine["cross_damping_asymmetry"] == pytest.approx(
        theirs["rate"] / theirs["cross_damping_asymmetry"], rel=1e-6
    )
    assert "nothing tells apart" in str(found)
    assert found.to_xarray()["singular_values"].shape == found.singular_values.shape


@pytest.mark.slow
def test_a_window_of_a_run_is_that_of_sixty_digits(loop):
    """The voltages of a window move with everything unknown as 60 digits say: each is moved by 1e-25 of its scale."""
    quiet = eqx.tree_at(lambda made: made.readout.noise_density, loop, (0.0, 0.0))
    settings = {"sample_rate": 20e3, "duration": 1e-3}
    for force, scenario in ((True, 1.0), (False, 0.0)):
        law = DampingCompensation(tones=Tone(600.0, 53.95)) if force else OpenLoop(tones=Tone(600.0, 0.0))
        run = eqx.tree_at(lambda made: made.controller, quiet, law)
        found = observability(run, scenario, window=1e-3, **settings)
        trace = simulate(run, scenario, **settings)
        exact, null = window_in_sixty_digits(run, trace, found, scenario)
        np.testing.assert_allclose(found.singular_values[0] / found.singular_values[0, 0], exact, rtol=1e-8, atol=1e-11)
        assert found.rank[0] == len(found.names) - len(null) == (14 if force else 13)
        assert has_null_space(found, null)


def window_in_sixty_digits(loop, trace, found, rate):
    """Singular values over the largest and null space of the voltages' sensitivities, commands held."""
    with mpmath.workdps(60):
        number = lambda value: mpmath.mpf(float(value))  # noqa: E731
        design = dict(zip(loop.device.model.names, map(number, loop.device.coefficients(rate)), strict=True))
        start = dict(zip(("x", "y", "vx", "vy"), map(number, loop.start), strict=True))
        period, volts = number(1.0) / number(20e3), [number(v) for v in loop.readout.scale]

        def run(at):
            stiffness = ((at["kxx"], at["kxy"]), (at["kxy"], at["kyy"]))
            velocity = ((at["dxx"], at["dxy"] - 2 * at["rate"]), (at["dxy"] + 2 * at["rate"], at["dyy"]))
            a = mpmath.zeros(6)
            for i in range(2):
                a[i, 2 + i], a[2 + i, 4 + i] = 1, at["sigma"]
                for j in range(2):
                    a[2 + i, j], a[2 + i, 2 + j] = -stiffness[i][j], -velocity[i][j]
            step, state, seen = mpmath.expm(a * period), mpmath.matrix([at[n] for n in start]), []
            for force in trace.force:
                state = (step * mpmath.matrix([*state, *map(number, force)]))[:4]
                seen += [volts[i] * state[i] + at[f"offset_{'xy'[i]}"] for i in range(2)]
            return seen

        here = {**start, **design, "offset_x": mpmath.mpf(0), "offset_y": mpmath.mpf(0)}
        small, plain, columns = mpmath.mpf(10) ** -25, run(here), []
        for name, scale in zip(found.names, found.scale, strict=True):
            moved = run({**here, name: here[name] + small * number(scale)})
            columns.append([(m - p) / small for m, p in zip(moved, plain, strict=True)])
        singular, null = decomposed(mpmath.matrix(columns).T.tolist())
        return singular / singular[0], null


@pytest.mark.slow
def test_without_a_tone_a_state_feedback_hides_the_mass(loop):
    with_tone = observability(loop, duration=3e-3)
    silent = ClosedLoop(loop.device, loop.readout, loop.observer, DampingCompensation(tones=Tone(600.0, 0.0)))
    without = observability(silent, duration=3e-3)
    assert set(with_tone.rank) == {14}
    assert np.all(with_tone.condition < 500)
    assert set(without.rank) == {13}
    assert "sigma" in without.null[0]
    unforced = ClosedLoop(loop.device, loop.readout, loop.observer, OpenLoop(tones=Tone(600.0, 0.0)))
    assert observability(unforced, duration=3e-3).null == ({"sigma": 1.0},)


@pytest.mark.slow
def test_a_filter_led_astray_by_what_no_run_tells_is_told_so(loop):
    observer = ExtendedKalmanFilter.for_device(loop.device, loop.readout)
    theta = np.array([[float(each) for each in observer.prior.theta]])
    for force, said in ((0.0, "tells nothing of dyy together with sigma"), (53.95, "did not bear being linearised")):
        run = ClosedLoop(loop.device, loop.readout, observer, DampingCompensation(tones=Tone(600.0, force)))
        found = divergence_of(np.arange(1), theta, run, as_scenario(1.0), Plan(1e-5, 1, 300, 0.0, 1.0))
        assert [said in cause for cause in found.causes] == [True]


def test_what_cannot_be_asked_is_one_sentence(loop):
    with pytest.raises(InputError, match="`window` must hold at least 7 samples and at most the run's 300"):
        observability(loop, duration=3e-3, window=4e-5)
    with pytest.raises(InputError, match="must name some of"):
        observability(loop, duration=3e-3, known=("nothing",))
    with pytest.raises(InputError, match="A coefficient must be one of"):
        matrix(SINGLE_MASS, ONE, known=("nothing",))
