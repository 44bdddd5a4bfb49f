"""The angle of the vibration: exact solutions, the thesis' averaged equations, both methods on ideal motion."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from kept import kept
from oracles import motion as oracle

import memsgyro_jax as mg
from memsgyro_jax.base.errors import InputError


FREQUENCY = 3200.0
W = 2.0 * np.pi * FREQUENCY
RATE_PEAK = np.radians(200.0)  # rad/s, at 10 Hz: thesis 7.1


def turned(a, b, angle, phase, omega, frame, frame_rate, time):
    """An ellipse of inertial space at `omega` [rad/s], seen from a frame at angle `frame` that turns at
    `frame_rate`.
    """
    theta = omega * time + phase
    w = np.exp(1j * angle) * (a * np.cos(theta) + 1j * b * np.sin(theta))
    dw = omega * np.exp(1j * angle) * (-a * np.sin(theta) + 1j * b * np.cos(theta))
    z, dz = w * np.exp(-1j * frame), (dw - 1j * frame_rate * w) * np.exp(-1j * frame)
    return z.real, z.imag, dz.real, dz.imag


def within_half_turn(angle):
    """The angle up to half turns, from -π/2 to π/2."""
    return (np.asarray(angle) + np.pi / 2) % np.pi - np.pi / 2


def ideal(frame, full):
    return oracle.single_mass(1.0, W**2, W**2, 0.0, 0.0, 0.0, 0.0, frame=frame, full=full)


@pytest.mark.parametrize("full", [False, True], ids=["thesis' equations", "all terms of the frame"])
@pytest.mark.parametrize("rate", [3.5, -40.0, 900.0])
def test_an_ideal_gyro_turns_exactly(full, rate):
    """Free motion of the matrices themselves, also at rates where the two forms differ by much more than rounding."""
    start = np.array(turned(1e-6, 0.3e-6, 0.4, 1.0, W, 0.0, 0.0, 0.0))
    count, step = 2000, 1e-5
    path = oracle.trajectory(ideal(oracle.Frame(wz=rate), full), start, np.zeros((count, 2)), step)
    first, *_ = path
    exact = lambda m: mg.vibration_angle(tuple(m.T), FREQUENCY, rate, rotating_frame=full)  # noqa: E731
    expected = float(exact(first[None])[0]) - rate * step * np.arange(count)
    assert np.max(np.abs(within_half_turn(exact(path) - expected))) < 1e-10
    if not full:
        ripple = within_half_turn(mg.vibration_angle(tuple(path.T), FREQUENCY) - expected)
        if abs(rate) < 100.0:  # (6.9): ± Ω/(2√k), more for an ellipse that is not a line: (a² + b²)/(a² - b²)
            assert np.max(np.abs(ripple)) == pytest.approx(abs(rate) / (2 * W) * 1.09 / 0.91, rel=0.02)


def test_all_terms_of_the_frame_make_it_exact_under_any_rate():
    time = np.arange(5000) / 20e3
    rate = RATE_PEAK * np.sin(2 * np.pi * 10 * time) + 30.0 * np.cos(2 * np.pi * 171.0 * time)
    frame = RATE_PEAK / (2 * np.pi * 10) * (1 - np.cos(2 * np.pi * 10 * time))
    frame = frame + 30.0 / (2 * np.pi * 171.0) * np.sin(2 * np.pi * 171.0 * time)
    seen = turned(1e-6, -0.2e-6, 0.3, 0.0, W, frame, rate, time)
    got = mg.vibration_angle(seen, FREQUENCY, rate, rotating_frame=True)
    assert np.max(np.abs(within_half_turn(got - (0.3 - frame)))) < 1e-10


def of_ellipse(a, b, angle, phase):
    """(6.5)."""
    c, s, cp, sp = np.cos(phase), np.sin(phase), np.cos(angle), np.sin(angle)
    x, y = a * c * cp - b * s * sp, a * c * sp + b * s * cp
    return x, y, W * (-a * s * cp - b * c * sp), W * (-a * s * sp + b * c * cp)


@pytest.mark.parametrize("drawn", np.random.default_rng(6).uniform(-1.0, 1.0, (6, 3)))
def test_ellipse_is_6_5(drawn):
    b, angle, phase = drawn * (0.9, 1.5, 3.1)
    found = mg.vibration_ellipse(of_ellipse(1.0, b, angle, phase), FREQUENCY)
    assert tuple(map(float, found[:3])) == pytest.approx((1.0, b, angle), abs=1e-12)
    assert np.exp(1j * float(found.phase)) == pytest.approx(np.exp(1j * phase), abs=1e-12)


def moved(motion, rate, force):
    """(6.3) as a derivative by time."""
    x, y, vx, vy = motion
    return vx, vy, -(W**2) * x + 2 * rate * vy + force[0], -(W**2) * y - 2 * rate * vx + force[1]


@pytest.mark.parametrize(("rate", "force"), [(3.5, (0.0, 0.0)), (0.0, (40.4, -11.0)), (-120.0, (3.0, 40.4))])
def test_ellipse_moves_as_6_6_and_6_7_say(rate, force):
    a, b, phi, theta = 1e-6, 0.35e-6, 0.5, 0.9
    motion = tuple(map(float, of_ellipse(a, b, phi, theta)))
    ellipse = lambda *m: mg.vibration_ellipse(m, FREQUENCY)  # noqa: E731
    got = jax.jvp(ellipse, motion, tuple(map(float, moved(motion, rate, force))))[1]
    along = np.array([[np.cos(phi), np.sin(phi)], [-np.sin(phi), np.cos(phi)]]) @ force
    c, s, gap = np.cos(theta), np.sin(theta), a**2 - b**2
    ab = np.array([-rate * b * np.sin(2 * theta), rate * a * np.sin(2 * theta)]) + np.array([-s, c]) * along / W
    second = -np.array([[-b * c, a * s], [a * c, -b * s]]) @ along / (W * gap)
    turning = 2 * rate * (b**2 * c**2 - a**2 * s**2) / gap
    running = -2 * rate * a * b * np.cos(2 * theta) / gap + W
    assert tuple(map(float, got[:2])) == pytest.approx(tuple(ab), rel=1e-9)
    assert (float(got.angle), float(got.phase)) == pytest.approx((turning + second[0], running + second[1]), rel=1e-9)
    # (6.7): what is left of the turning after -Ω and the auxiliary force is F_1H, at twice the vibration.
    assert turning == pytest.approx(-rate + rate * np.cos(2 * theta) * (a**2 + b**2) / gap, rel=1e-12)


@pytest.fixture(scope="module")
def swaying():
    """Ideal motion under 200 sin(2π 10 t) deg/s from 0.05 s on, at 20 kHz: motion, and the frame's angle by time."""
    rate_of = lambda t: np.where(t < 0.05, 0.0, RATE_PEAK * np.sin(2 * np.pi * 10 * (t - 0.05)))  # noqa: E731
    frame_of = lambda t: np.where(  # noqa: E731
        t < 0.05, 0.0, RATE_PEAK / (2 * np.pi * 10) * (1 - np.cos(2 * np.pi * 10 * (t - 0.05)))
    )
    time = np.arange(6000) / 20e3
    return np.stack(turned(1e-6, 0.1e-6, 0.2, 0.0, W, frame_of(time), rate_of(time), time), axis=1), frame_of


@pytest.mark.parametrize(
    ("method", "options", "claim"),
    [
        (mg.angle_by_lowpass, {}, 1.1e-4),
        (mg.angle_by_lowpass, {"moving": 10.0}, 1e-6),
        (mg.angle_by_bandpass, {}, 3e-3),
    ],
    ids=["method 1", "method 1, delay at 10 Hz", "method 2"],
)
def test_methods_on_ideal_motion(swaying, method, options, claim):
    """The lag is 2.08 ms; taken off, what is left of ±6.4° is the filters' own distortion."""
    motion, frame_of = swaying
    got = method(motion, FREQUENCY, 20e3, **options)
    assert -float(got.time[0]) == pytest.approx(2.08e-3, abs=0.01e-3)
    late = np.asarray(got.time) > 0.1  # where the rate sets in, the angle has a kink
    error = np.degrees(np.asarray(got.angle) - 0.2 + frame_of(np.asarray(got.time)))[late]
    assert np.sqrt(np.mean(error**2)) < claim
    uncorrected = np.degrees(np.asarray(got.angle) - 0.2 + frame_of(np.arange(len(motion)) / 20e3))[late]
    assert np.sqrt(np.mean(uncorrected**2)) > 0.2


@pytest.mark.parametrize("phase", [0.0, 0.5 * np.pi], ids=["a line", "a circle"])
def test_a_tone_leaves_ripple_and_no_offset(phase):
    """2φ is the angle of a product of two circular motions; a smaller tone adds to it powers of its own, none at rest.
    F_2H stands at 2.7 and 3.7 kHz (Fig 7.6).
    """
    time = np.arange(4000) / 20e3
    free = np.stack(turned(1e-6, 0.1e-6, 0.4, 0.0, W, 0.0, 0.0, time), axis=1)
    tone, a = 2 * np.pi * 500.0, 0.1e-6
    x, y = tone * time, tone * time + phase
    added = a * np.stack([np.sin(x), np.sin(y), tone * np.cos(x), tone * np.cos(y)], axis=1)
    seen = np.degrees(mg.vibration_angle(tuple((free + added).T), FREQUENCY)) - np.degrees(0.4)
    spectrum = np.abs(np.fft.rfft(seen)) * 2 / len(time)
    lines = np.fft.rfftfreq(len(time), 1 / 20e3)
    assert np.sort(lines[np.argsort(spectrum)[-2:]]) == pytest.approx([2700.0, 3700.0])
    assert abs(np.mean(seen)) < 1e-8
    behind = np.degrees(mg.angle_by_lowpass(free + added, FREQUENCY, 20e3).angle)[2000:] - np.degrees(0.4)
    assert np.max(np.abs(behind)) < 1e-3


def test_angles_have_gradients_and_map_over_runs():
    motions = jnp.asarray(np.stack(of_ellipse(1.0, 0.2, 0.3, np.linspace(0, 1, 4))))
    slope = jax.grad(lambda m: jnp.sum(mg.vibration_angle(m, FREQUENCY, 2.0)))(tuple(motions))
    assert all(np.all(np.isfinite(part)) for part in slope)
    one = [float(mg.vibration_angle(tuple(column), FREQUENCY)) for column in motions.T]
    assert np.array_equal(jax.vmap(lambda m: mg.vibration_angle(tuple(m), FREQUENCY))(motions.T), one)


def test_a_band_above_half_the_sample_rate_is_refused():
    with pytest.raises(InputError, match=r"more than twice the filter's 3400 Hz"):
        mg.angle_by_bandpass(np.ones((10, 4)), FREQUENCY, 5e3)


@pytest.mark.slow
def test_a_trace_tells_the_angle_beside_the_integrated_rate(swaying, tmp_path):
    """A short run whose rows are exchanged for ideal ones, under a law that rocks, and a rate that is 1 deg/s off."""
    motion, frame_of = swaying
    gyro, readout = mg.SingleMassGyro.chi2010(), mg.DirectReadout.of_velocity(1.0, 1e-9)
    law = mg.WholeAngle(FREQUENCY, rocking=mg.Tone(120.0, 1.2))
    law = mg.EnergyControl(law, (FREQUENCY, FREQUENCY), (1e-6, 0.0), 1.0)
    loop = mg.ClosedLoop(gyro, readout, mg.LyapunovObserver.for_device(gyro, readout), law)
    trace = mg.simulate(loop, sample_rate=1e6, duration=2e-5)
    time = np.arange(len(motion)) / 20e3
    rate = np.where(time < 0.05, 0.0, RATE_PEAK * np.sin(2 * np.pi * 10 * (time - 0.05)))
    rocked = np.stack(eqx.tree_at(lambda w: w.rocking.amplitude, law.inner, -1.2).unrocked(tuple(motion.T), time), 1)
    with pytest.raises(InputError, match=r"`start` must lie before the last angle"):
        mg.turned_angle(trace, start=1.0)
    fields = lambda t: (t.time, t.motion_estimate, t.rate_true, t.rate_unfiltered)  # noqa: E731
    trace = eqx.tree_at(fields, trace, (time, rocked, rate, rate + np.radians(1.0)))
    found = mg.turned_angle(trace, start=0.05)
    assert np.degrees(np.max(np.abs(found.true - (frame_of(found.time) - frame_of(found.time[0]))))) < 1e-3
    assert np.degrees(np.sqrt(np.mean(found.error**2))) < 2e-3
    drift = np.degrees(found.integrated - found.true)
    assert drift[-1] == pytest.approx(found.time[-1] - found.time[0], abs=2e-3)
    assert "integrated rate: rms error" in repr(found)
    assert kept(found, tmp_path).sizes["time"] == len(found.time)
    assert len(found.plot().lines) == 2
    with pytest.raises(InputError, match="must have a WholeAngle controller, but it has OpenLoop"):
        mg.turned_angle(eqx.tree_at(lambda t: t.loop.controller, trace, mg.OpenLoop()))
