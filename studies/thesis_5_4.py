"""How much does the thesis' own observer filter? Thesis 5.4.2, claim T18, and what a better motion and observer give.

Reference-model control makes the axes swing at 3 and 5 kHz, mass and circuit are known, the velocity read-out has SNR
1000. The observer of (4.11) with gain 100 is claimed to show 40.1 deg/s raw and 0.88 deg/s behind a third-order 10 Hz
low-pass. The sampling rate of the noise and the length unit of the gain are not stated; 1 µm and noise drawn at 1 MHz
fit best. Then each axis is driven at the *other* axis's mode, which is where it answers a rate most, and the Kalman
filter takes the observer's place.
"""

import equinox as eqx
import matplotlib.pyplot as plt
import numpy as np
from _common import PARTLY, Report, dps, draw_coefficients, draw_motion, draw_path, rms, seeds

import memsgyro_jax as mg
from memsgyro_jax.base import runtime


runtime.configure()

PLACE = "thesis 5.4.2"
ANSWERS = ("T18",)
FIGURES = {"5.18": "path", "5.19": "motion", "5.20": "estimates", "5.21": "observers"}
NOISE_RATE, SPEED = 1e6, 2.0 * np.pi * 3000.0 * 1e-6  # Hz; m/s of a 1 µm motion at 3 kHz
GYRO = mg.SingleMassGyro.chi2010()
READOUT = mg.DirectReadout.of_velocity(1.0, mg.snr_density(1000.0, SPEED, 1.0, NOISE_RATE))
THESIS, SWAPPED = (3000.0, 5000.0), (3758.8, 2893.1)  # Hz; SWAPPED: each axis at the other one's mode
CLAIMS = {"kxx": 1.1e-4, "kyy": 6.2e-5, "kxy": 3.9e-4, "dxx": 0.09, "dyy": 0.07, "dxy": 0.83}


def closed(observer, frequencies) -> mg.ClosedLoop:
    return mg.ClosedLoop(GYRO, READOUT, observer, mg.ReferenceModel(frequencies), start=(1e-6, 1e-6, 0.0, 0.0))


def lyapunov(frequencies, gain=100.0) -> mg.ClosedLoop:
    observer = mg.LyapunovObserver.for_device(GYRO, READOUT, gain=gain, known=("sigma",), start=0.8,
                                           motion=(1e-6, 1e-6, 0.0, 0.0))  # fmt: skip
    return closed(observer, frequencies)


def kalman(frequencies) -> mg.ClosedLoop:
    """Starts as the other observer does. The rate may walk, by as much as makes the filter about as fast as 10 Hz:
    its time constant is information per second over walk per second, with everything else known by then."""
    prior = mg.design_prior(GYRO, spread=0.2)
    theta = tuple(v if n == "sigma" else 0.8 * v for n, v in zip(GYRO.model.names, prior.theta, strict=True))
    prior = eqx.tree_at(lambda p: (p.theta, p.motion), prior, (theta, (1e-6, 1e-6, 0.0, 0.0)))
    observer = mg.ExtendedKalmanFilter.for_device(GYRO, READOUT, known=("sigma",), with_offsets=False, prior=prior)
    known = (*(name for name in GYRO.model.names if name != "rate"), "offset_x", "offset_y")
    bound = mg.information_bound(closed(observer, frequencies), 0.0, sample_rate=400e3, known=known, windows=1)
    walk = float(bound.rate_std[-1]) ** 2 * 0.1 * (2.0 * np.pi * 10.0) ** 2
    noise = mg.ProcessNoise.of(GYRO.model, rate=walk)
    return closed(eqx.tree_at(lambda o: o.process_noise, observer, noise), frequencies)


def steady(loop: mg.ClosedLoop, count: int, sample_rate: float, duration: float):
    """5 deg/s from 1 s on, as the thesis' long run: raw and filtered error about the truth after 2 s, root mean square
    in deg/s; the filtered one's own standard deviation; the runs."""
    scenario = mg.Step(1.0, np.radians(5.0)) + mg.Step(1.0, 0.0)  # of the structure of the thesis' run
    runs = seeds(loop, scenario, count=count, sample_rate=sample_rate, duration=duration, points=round(1000 * duration))
    late = runs.time > 2.0
    raw, filtered = (dps(rate - runs.rate_true)[late] for rate in (runs.rate, runs.filtered))
    return float(rms(raw)), float(rms(filtered)), float(np.mean(np.std(filtered, axis=0))), runs


def settled(runs) -> float:
    """Time after which every stiffness of every run stays within 1 %."""
    truth = np.asarray(GYRO.coefficients(0.0))[1:4]
    outside = np.any(np.abs(runs.theta[:, 1:4] / truth[:, None] - 1.0) > 0.01, axis=(1, 2))
    return float(runs.time[np.flatnonzero(outside)[-1] + 1])


report = Report()
count, duration = (4, 2.5) if report.quick else (16, 5.0)
figure, (left, right) = plt.subplots(1, 2, figsize=(11, 4), layout="constrained")

# The thesis' run: 1 rad/s from 0.2 s, -3 rad/s from 0.6 s.
turning = mg.Step(0.2, 1.0) + mg.Step(0.6, -4.0)
whole, start = ((duration, round(1000 * duration)),) * 2 if report.quick else ((1.0, 1000), (0.2, 1000))
given = {"count": count, "sample_rate": NOISE_RATE}  # the quick runs are all of one length, for one program
run = seeds(lyapunov(THESIS), turning, duration=whole[0], points=whole[1], **given)
truth = np.asarray(GYRO.coefficients(0.0))
index = [GYRO.model.names.index(name) for name in CLAIMS]
error = run.theta[:, index] / truth[index][:, None] - 1.0
report.row("stiffnesses stay within 1 % from [s]", "< 0.02", settled(run), "gain 100")
still = mg.Step(0.2, 0.0) + mg.Step(0.6, 0.0)
quick = seeds(lyapunov(THESIS, gain=12.0), still, duration=start[0], points=start[1], **given)
report.row("  with gain 12 [s]", "slower", settled(quick), "adaptation goes as 1/gain: the claimed sign is wrong")
largest = np.mean(np.max(np.abs(error[run.time > 0.8]), axis=0), axis=1)
for (name, claim), found in zip(CLAIMS.items(), largest, strict=True):
    report.row(f"{name}, largest relative error after 0.8 s", claim, float(found), "mean over the seeds")
left.plot(run.time, dps(run.rate[:, 0]), "C7", lw=0.5, label="observer, raw")
left.plot(run.time, dps(run.filtered[:, 0]), "C0", label="behind 10 Hz, 3rd order")
left.plot(run.time, dps(run.rate_true[:, 0]), "k--", label="true rate")
left.set(xlabel="time [s]", ylabel="rate [deg/s]", ylim=(-350, 250), title="Lyapunov observer, 3/5 kHz, one run")

for drive, name, claims in ((THESIS, "3/5 kHz", (0.88, "-")), (SWAPPED, "other axis's mode", ("-", "-"))):
    both = (("Lyapunov", lyapunov(drive), NOISE_RATE), ("Kalman", kalman(drive), 400e3))
    for (observer, loop, sample_rate), claim in zip(both, claims, strict=True):
        raw, filtered, own, runs = steady(loop, count, sample_rate, duration)
        report.row(f"{observer}, {name}: raw [deg/s]", 40.1 if claim == 0.88 else "-", raw,
                   f"depends on the sampling rate, here {sample_rate / 1e3:g} kHz")  # fmt: skip
        report.row(f"{observer}, {name}: filtered [deg/s]", claim, filtered,
                   f"after 2 s about the truth, {count} seeds; one run's own std {own:.2g}")  # fmt: skip
        style = {"lw": 0.8, "label": f"{observer}, {name}: {filtered:.2g} deg/s"}
        right.plot(runs.time, dps(runs.filtered - runs.rate_true)[:, 0], **style)
right.set(xlabel="time [s]", ylabel="filtered rate error [deg/s]", ylim=(-4, 4), xlim=(1.2, duration),
          title="equal noise density, one run each")  # fmt: skip
for ax in (left, right):
    ax.legend(frameon=False, fontsize=8)
report.picture(figure, "observers")

trace = mg.simulate(lyapunov(THESIS), 1.0, sample_rate=NOISE_RATE, duration=4e-3, decimation=5)
report.picture(draw_motion(trace), "motion")
figure, ax = plt.subplots(figsize=(5, 5), layout="constrained")
draw_path(ax, trace)
report.picture(figure, "path")
report.picture(draw_coefficients(lyapunov(THESIS), run.time, run.theta[:, :, 0], run.rate_true[:, 0]), "estimates")
raw, filtered, other, kalman_other = (report.found(what) for what in (
    "Lyapunov, 3/5 kHz: raw [deg/s]", "Lyapunov, 3/5 kHz: filtered [deg/s]",
    "Lyapunov, other axis's mode: filtered [deg/s]", "Kalman, other axis's mode: filtered [deg/s]"))  # fmt: skip
report.answer(
    "T18",
    claimed="40.1 deg/s raw, 0.88 deg/s filtered, converged within 0.02 s, gain 100",
    obtained=f"{raw:.3g} raw, {filtered:.2g} deg/s filtered, stiffnesses within 1 % from "
    f"{report.found('stiffnesses stay within 1 % from [s]'):.2g} s; each axis at the other one's mode {other:.2g}, "
    f"Kalman filter there {kalman_other:.2g} deg/s",
    reading=f"gain 12 converges within {report.found('  with gain 12 [s]'):.2g} s; the raw figure depends on the "
    "sampling rate, which is not stated",
    verdict=PARTLY,
    why="The filtered figure is reproduced; the motion, not the observer, limits it, and the other mode tells more.",
)
report.finish()
