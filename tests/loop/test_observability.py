"""Ranks, singular values and null directions against a 60-digit computation, theory and the information bound."""

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


def sixty_digits(model, motion, force, time, *, velocity, unit_of_time=4000.0):
    """Singular values of the same matrix from written-out derivatives, with mpmath."""
    with mpmath.workdps(60):
        omega, time = 2 * mpmath.pi * unit_of_time, mpmath.mpf(float(time))

        def derivative(parts, order):
            total = mpmath.mpf(0)
            for frequency, (s, c) in parts.items():
                w = 2 * mpmath.pi * frequency
                angle = w * time + order * mpmath.pi / 2
                total += (w / omega) ** order * (s * mpmath.sin(angle) + c * mpmath.cos(angle))
            return total

        count = len(model.coefficients)
        rows = []
        for k in range(count):
            axis, order = k % 2, k // 2 + velocity
            signals = [derivative(parts, order) for parts in motion]
            signals += [derivative(parts, order + 1) for parts in motion] + [
                derivative(parts, order) for parts in force
            ]
            row = [
                sum(mpmath.mpf(t.factor) * signals[t.signal] for t in c.terms if t.axis == axis)
                for c in model.coefficients
            ]
            rows.append(row)
        return np.array([float(s) for s in mpmath.svd_r(mpmath.matrix(rows), compute_uv=False)])


def matrix(model, motion, force=({}, {}), *, velocity=True, time=TIME, **options):
    return observability_matrix(
        model, formula(motion), formula(force), time, frequency=4000.0, velocity=velocity, **options
    )


@pytest.mark.parametrize("velocity", [True, False])
@pytest.mark.parametrize("model", [SINGLE_MASS, DUAL_MASS])
def test_singular_values_are_those_of_sixty_digits(model, velocity):
    force = fed_back(BOTH, tone=0.4)
    found = matrix(model, BOTH, force, velocity=velocity)
    time = TIME
    largest = max(abs(float(v)) for v in np.stack(formula(BOTH, 1.0)(jnp.asarray(time))).ravel())
    pushed = max(abs(float(v)) for v in np.stack(formula(force, 1.0)(jnp.asarray(time))).ravel())
    scaled = tuple({f: tuple(v / largest for v in pair) for f, pair in axis.items()} for axis in BOTH)
    pushes = tuple({f: tuple(v / pushed for v in pair) for f, pair in axis.items()} for axis in force)
    for place, instant in enumerate(time):
        exact = sixty_digits(model, scaled, pushes, instant, velocity=velocity)
        np.testing.assert_allclose(found.singular_values[place], exact, rtol=1e-9, atol=1e-12 * exact[0])


def test_ranks_of_thesis_4_1_to_4_3():
    known, both = {"known": ("sigma",)}, {"known": ("sigma",), "also": (CROSS_DAMPING_ASYMMETRY,)}
    assert set(matrix(SINGLE_MASS, ONE, **known).rank) == {4}
    assert set(matrix(SINGLE_MASS, BOTH, **known).rank) == {7}
    unequal = matrix(SINGLE_MASS, BOTH, **both)
    assert set(unequal.rank) == {7}
    assert unequal.null == ({"rate": pytest.approx(-0.25), "cross_damping_asymmetry": 1.0},)
    symmetric = ((0.3, 0.5), (0.5, 0.7))
    for model, ranks in ((SINGLE_MASS, (4, 7, 8, 8)), (DUAL_MASS, (4, 8, 8, 10))):
        forces = fed_back(ONE), fed_back(APART, symmetric), fed_back(APART), fed_back(APART, tone=1.0)
        motions = ONE, APART, APART, APART
        found = [matrix(model, *pair) for pair in zip(motions, forces, strict=True)]
        assert tuple(int(f.rank.min()) for f in found) == tuple(int(f.rank.max()) for f in found) == ranks
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


def test_what_cannot_be_asked_is_one_sentence(loop):
    with pytest.raises(InputError, match="`window` must hold at least 7 samples and at most the run's 300"):
        observability(loop, duration=3e-3, window=4e-5)
    with pytest.raises(InputError, match="must name some of"):
        observability(loop, duration=3e-3, known=("nothing",))
    with pytest.raises(InputError, match="A coefficient must be one of"):
        matrix(SINGLE_MASS, ONE, known=("nothing",))
