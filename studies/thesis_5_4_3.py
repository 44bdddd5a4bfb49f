"""Which feedback law lets the thesis' observer converge? Thesis 4.2 and 5.4.3, claims T12 and T19, without noise.

The observer of (4.11) with gain 12 starts with coefficients of 80 %, the device turns at 1 rad/s. Damping compensation
(4.27), the reference model (4.17) of 3 and 3.674 kHz, and the same with energy control (4.25), with and without the
observer's energy state (4.22) to (4.24), each from starts of 1 µm whose phases are drawn: the thesis shows one start of
each. A run has converged when from then on rate and dampings stay within 5 %, stiffnesses within 1 % and the cross
damping within half.
"""

from dataclasses import replace

import equinox as eqx
import numpy as np
from _common import FAILS, PARTLY, Report, draw_coefficients, draw_motion, draw_path, seeds

import memsgyro_jax as mg
from memsgyro_jax.base import runtime


runtime.configure()

PLACE = "thesis 4.2, 5.4.3"
ANSWERS = ("T12", "T19")
FIGURES = {
    "5.22": "motion_damping", "5.23": "estimates_damping", "5.24": "motion_reference", "5.25": "estimates_reference",
    "5.26": "motion_energy", "5.27": "estimates_energy",
}  # fmt: skip
GYRO, READOUT = mg.SingleMassGyro.chi2010(), mg.DirectReadout.of_velocity(1.0)
OMEGA, SAMPLE_RATE = 2.0 * np.pi * 3000.0, 2e6
PAIR, LEVEL, MODES = (3000.0, 3674.0), (1e-6, 1e-6), (2893.1, 3758.8)
THESIS_GAIN = OMEGA * 0.5 * sum((f / 3000.0) ** 2 for f in PAIR)  # of EnergyControl: that of (4.25), 1 µm the unit
TOLERANCE = np.array([0.05, 0.01, 0.01, 0.01, 0.05, 0.05, 0.5])


def phases(count: int, frequencies, size: float = 1e-6):
    """Starts of one amplitude: (x, y, vx, vy), each with one value per run; the first begins at rest at its height."""
    drawn = np.random.default_rng(1).uniform(0.0, 2.0 * np.pi, (2, count))
    drawn[:, 0] = 0.0
    place = (size * np.cos(phase) for phase in drawn)
    speed = (-2.0 * np.pi * f * size * np.sin(phase) for f, phase in zip(frequencies, drawn, strict=True))
    return (*place, *speed)


def closed(law, start, *, energy: float = 0.0, off: float = 0.8, gyro=GYRO, gain: float = 12.0):
    """The observer knows where the mass starts; its energy state is driven by `energy` times the thesis' gain."""
    inner = mg.LyapunovObserver.for_device(gyro, READOUT, gain=gain, known=("sigma",), start=off, motion=start)
    return mg.ClosedLoop(gyro, READOUT, mg.EnergyObserver(inner, PAIR, LEVEL, energy), law, start)


def reference(gain: float = 0.0, frequencies=PAIR) -> mg.EnergyControl:
    return mg.EnergyControl(mg.ReferenceModel(frequencies), frequencies, LEVEL, gain)


def converged(runs) -> np.ndarray:
    """When each run has converged, in s; infinite for one that has not."""
    truth = np.asarray(GYRO.coefficients(1.0))[:7, None]
    bad = np.any(np.abs(runs.theta[:, :7] / truth - 1.0) > TOLERANCE[:, None], axis=1)
    first = [np.flatnonzero(column)[-1] + 1 if column.any() else 0 for column in bad.T]
    return np.array([np.inf if i >= len(runs.time) else runs.time[i] for i in first])


def from_starts(report: Report, name: str, claim: object, law, frequencies, count: int, duration: float, *,
                size: float = 1e-6, **options):  # fmt: skip
    """One row: how many of the starts converge, and when."""
    start = phases(count, frequencies, size)
    design = closed(law, tuple(float(v[0]) for v in start), **options)
    given = {"count": count, "sample_rate": SAMPLE_RATE, "duration": duration, "points": 500, "design": design}
    runs = seeds(closed(law, start, **options), 1.0, **given)
    times = converged(runs)
    good = times[np.isfinite(times)]
    when = f"{good.min():.2g} to {good.max():.2g} s, median {np.median(good):.2g}" if good.size else "never"
    swing = 1e6 * np.max(np.abs(runs.motion[-50:, :2]), axis=0)
    said = f"{when}; first start {times[0]:.2g} s; {runs.lost} lost; least axis keeps {swing.min():.2g} µm"
    report.row(f"{name}: converged of {count}", claim, len(good), said)
    return times, runs


def analytic(time, k, kxy, rate, size):
    """(4.30): matched axes, damping cancelled."""
    xi = np.sqrt(kxy**2 + 4.0 * rate**2 * (k + rate**2))
    first, second = np.sqrt(k + 2.0 * rate**2 + xi), np.sqrt(k + 2.0 * rate**2 - xi)
    cosines, sines = np.cos(np.outer((first, second), time)), np.sin(np.outer((first, second), time))
    share = rate**2 / xi
    x = (0.5 + share) * cosines[0] + (0.5 - share) * cosines[1]
    y = kxy / (2.0 * xi) * (cosines[0] - cosines[1]) - k * rate / xi * (sines[0] / first - sines[1] / second)
    return size * np.stack([x, y], axis=1)


report = Report()
count, duration = (8, 0.1) if report.quick else (32, 0.5)
laws = {
    "reference model": ("0.2 s", reference(), PAIR, {}),
    "reference model, energy control": ("0.1 s", reference(THESIS_GAIN), PAIR, {}),
    "  and the observer's energy state": ("0.1 s", reference(THESIS_GAIN), PAIR, {"energy": 1.0}),
    "  with a tenth of both gains": ("-", reference(0.1 * THESIS_GAIN), PAIR, {"energy": 0.1}),
    "reference model, from 50 nm": ("-", reference(), PAIR, {"size": 50e-9}),
    "  with energy control and state": ("-", reference(THESIS_GAIN), PAIR, {"energy": 1.0, "size": 50e-9}),
    "reference model, equal frequencies": ("none", reference(frequencies=(3e3, 3e3)), (3e3, 3e3), {}),
    "reference model, gain 100, 3/5 kHz": ("0.02 s", reference(frequencies=(3e3, 5e3)), (3e3, 5e3), {"gain": 100.0}),
}
found = {}
for name, (claim, law, frequencies, options) in laws.items():
    found[name], _ = from_starts(report, name, claim, law, frequencies, count, duration, **options)
for limit in (100e-6, 30e-6, 15e-6, 8e-6):  # right coefficients ask for 13 µN
    law = mg.Saturated(reference(THESIS_GAIN), (limit, limit))
    name = f"energy control and state, forces up to {1e6 * limit:g} µN"
    found[name], _ = from_starts(report, name, "-", law, PAIR, count, duration, energy=1.0)
bare = mg.DampingCompensation()
for off in (0.8, 0.9, 0.95, 0.98):
    name = f"damping compensation, start {100 * (1 - off):.0f} % off"
    found[off], runs = from_starts(report, name, "0.05 s" if off == 0.8 else "-", bare, MODES, count, duration, off=off)
    if off == 0.8:
        end = runs.theta[-1, 4:6] / np.asarray(GYRO.coefficients(0.0))[4:6, None]
        said = "a wrong damping kills one mode, or makes it grow; what is left tells two frequencies no longer"
        report.row("  where dxx and dyy end, of the truth", "1", f"{end.min():.2g} to {end.max():.2g}", said)

# Energy beside the Lyapunov function: what (4.24) is for.
start = (1e-6, 1e-6, 0.0, 0.0)
traces = {
    "reference": closed(reference(), start),
    "energy": closed(reference(THESIS_GAIN), start, energy=1.0),
    "damping": closed(bare, start, off=0.98),
}
for name, loop in traces.items():
    trace = mg.simulate(loop, 1.0, sample_rate=SAMPLE_RATE, duration=0.06, decimation=16)
    if name == "energy":
        plain = replace(trace, loop=eqx.tree_at(lambda tree: tree.observer, loop, loop.observer.inner))
        value = mg.lyapunov_function(plain).value
        speeds = trace.motion[:, 2:] / (1e-6 * OMEGA)
        swing = trace.motion[:, :2] * np.array(PAIR) / 3000.0 / 1e-6
        excess = 0.5 * np.sum(speeds**2 + swing**2, axis=1) - THESIS_GAIN / OMEGA
        total = value + 0.5 * excess**2
        rise = np.max(total - np.minimum.accumulate(total)) / total[0]
        report.row("V + (E0 - E)²/2: largest rise, of its start", "0", float(rise),
                   "by (4.24) it should fall; the work of the motion's own error is left out there")  # fmt: skip
        report.row("V + (E0 - E)²/2 at 60 ms, of its start", "-> 0", float(total[-1] / total[0]))
    short = trace.time < 3e-3
    rows = {field: getattr(trace, field)[short] for field in ("time", "volts", "motion", "motion_estimate")}
    report.picture(draw_motion(replace(trace, **rows)), f"motion_{name}")
    figure = draw_coefficients(loop, trace.time, trace.theta_estimate, trace.rate_true)
    place = figure.axes[6]  # of the mass, which is known
    place.clear()
    draw_path(place, trace)
    report.picture(figure, f"estimates_{name}")

matched = eqx.tree_at(lambda gyro: gyro.kyy, GYRO, GYRO.kxx)
still = closed(bare, (1e-6, 0.0, 0.0, 0.0), off=1.0, gyro=matched)
for sample_rate in (2e6,) if report.quick else (1e6, 2e6):
    trace = mg.simulate(still, 1.0, sample_rate=sample_rate, duration=5e-3, decimation=round(sample_rate / 5e5))
    k, kxy = (float(v) / float(matched.mass) for v in (matched.kxx, matched.kxy))
    gap = np.max(np.abs(trace.motion[:, :2] - analytic(trace.time, k, kxy, 1.0, 1e-6))) / 1e-6
    report.row(f"(4.30) beside a run of 5 ms, {sample_rate / 1e3:g} kHz, of 1 µm", "0", float(gap), "matched axes")

told = {name: (int(np.sum(np.isfinite(times))), times) for name, times in found.items()}
good, times = told["reference model"]
kept, later = told["  and the observer's energy state"]
report.answer(
    "T19",
    claimed="converged within 0.05 s (damping compensation), 0.2 s (reference model), 0.1 s (with energy control)",
    obtained=f"within {duration:g} s damping compensation {told[0.8][0]} of {count} starts, reference model {good} "
    f"(median {np.median(times[np.isfinite(times)]):.2g} s), with energy control and energy state {kept} (median "
    f"{np.median(later[np.isfinite(later)]):.2g} s)",
    reading=f"damping compensation from 2 % error instead of 20: {told[0.98][0]} of {count}; energy control without "
    f"the observer's energy state {told['reference model, energy control'][0]} of {count}",
    verdict=PARTLY if good else FAILS,
    why="Whether and when it converges depends on the start's phase, of which the thesis shows one: a wrong damping "
    "empties one mode before it is right, and nothing tells the rest then; the energy state mends that.",
)
report.answer(
    "T12",
    claimed="reference model, energy control, damping compensation and tones give two frequencies; motion (4.30)",
    obtained=f"(4.30) to {gap:.1g} of the amplitude; every law equals an independent integrator to first order of the "
    "sample (a test); with right coefficients each holds its motion",
    reading="not needed",
    verdict=PARTLY,
    why="The laws are right (y's velocity belongs to d_yy in (4.18)); that estimation converges under them is another "
    "claim, see T19.",
)
report.finish()
