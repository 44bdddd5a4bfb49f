"""Does the thesis' observer make its Lyapunov function fall? Thesis 4.3, claims T9 and T13.

V and its slope along real runs of the loop, noise-free, from 20 % wrong coefficients: the slope of the observer's
equations, differentiated, beside the quadratic form that theory gives for it, and beside what the sampled run loses.
"""

import matplotlib.pyplot as plt
import numpy as np
from _common import HOLDS, PARTLY, Report

import memsgyro_jax as mg
from memsgyro_jax.base import runtime


runtime.configure()

PLACE = "thesis 4.3"
ANSWERS = ("T9", "T13")
READOUT = mg.DirectReadout.of_velocity(1.0)
START = (1e-6, 1e-6, 0.0, 0.0)
DEVICES = {"one mass": mg.SingleMassGyro.chi2010(), "two masses": mg.DualMassGyro.chi2010()}


def run(gyro, gain: float, sample_rate: float, duration: float) -> mg.Trace:
    observer = mg.LyapunovObserver.for_device(gyro, READOUT, gain=gain, start=0.8, motion=START)
    controller = mg.ReferenceModel((3000.0, 5000.0), mg.Tone(600.0, 53.95))
    loop = mg.ClosedLoop(gyro, READOUT, observer, controller, START)
    return mg.simulate(loop, 1.0, sample_rate=sample_rate, duration=duration, decimation=round(sample_rate / 1e6))


def lost(trace: mg.Trace, found: mg.LyapunovFunction) -> np.ndarray:
    """Integral of the slope along the run."""
    time = trace.time * float(trace.loop.observer.frequency)
    return np.concatenate([[0.0], np.cumsum(np.diff(time) * 0.5 * (found.slope[1:] + found.slope[:-1]))])


report = Report()
duration = 1e-3 if report.quick else 20e-3
figure, axes = plt.subplots(1, 2, figsize=(10, 4), layout="constrained")
for ax, (name, gyro) in zip(axes, DEVICES.items(), strict=True):
    trace = run(gyro, 5.0, 2e6, duration)
    found = mg.lyapunov_function(trace)
    size = np.max(np.abs(found.slope))
    off = np.max(np.abs(found.slope - found.expected)) / size
    report.row(f"{name}: |slope - theory|, of the largest slope", "0", float(off),
               "(4.33)" if name == "one mass" else "(4.42) with R = diag(1, kxy/kyx)")  # fmt: skip
    report.row(
        f"{name}: largest slope, of the largest fall", "<= 0", float(np.max(found.slope) / size), "V never rises"
    )
    for rate in (1e6, 2e6, 4e6):
        other = run(gyro, 5.0, rate, 1e-3)
        there = mg.lyapunov_function(other)
        fall = there.value[0] - there.value[-1]
        gap = np.max(np.abs(there.value - there.value[0] - lost(other, there))) / fall
        report.row(f"{name}: run beside integral of the slope, {rate / 1e6:g} MHz", "-", float(gap), "of the fall")
    report.row(
        f"{name}: V left after {1e3 * duration:g} ms, of its start", "-> 0", float(found.value[-1] / found.value[0])
    )
    ax.semilogy(1e3 * trace.time, found.value, label="V")
    ax.semilogy(1e3 * trace.time, np.maximum(-found.slope, 1e-16), lw=0.5, label="-dV/dτ")
    ax.set(xlabel="time [ms]", title=name, ylabel="without units")
    ax.legend(frameon=False)
    if name == "two masses":
        printed = mg.lyapunov_function(trace, weighted=False)
        off = np.max(np.abs(printed.slope - printed.expected)) / size
        report.row(f"{name}: |slope - (4.42)| as printed (R = 1)", "0", float(off),
                   "the term ½ e₁ᵀ(K - Kᵀ)e₂ of either sign is left out")  # fmt: skip
        report.row(f"{name}: least gain, per |Ω|", 1.0, float(mg.least_gain(gyro, 1.0)), "|r Ω - Ωr|/√r, r = kxy/kyx")
report.picture(figure, "lyapunov_function")
end = f"V left after {1e3 * duration:g} ms, of its start"
told = ("|slope - theory|, of the largest slope", "largest slope, of the largest fall", end)
off, falls, share = ([report.found(f"{name}: {what}") for name in DEVICES] for what in told)
report.answer(
    "T9",
    claimed="the observer converges from anywhere, by Lyapunov's direct method",
    obtained=f"V never rises from 20 % wrong coefficients (largest slope {max(falls):.1e} of the largest fall); after "
    f"{1e3 * duration:g} ms {share[0]:.2g} (one mass) and {share[1]:.2g} (two) of it are left",
    reading="not needed",
    verdict=HOLDS,
    why="With rich motion, and for two masses with V weighted by R = diag(1, kxy/kyx).",
)
report.answer(
    "T13",
    claimed="dV/dt <= 0 on runs, (4.33) and (4.42); a gain above |Ω| is enough for two masses",
    obtained=f"slope equals theory within {max(off):.1e}; two masses need "
    f"{report.found('two masses: least gain, per |Ω|'):.4g}·|Ω|",
    reading=f"(4.42) as printed, R = 1, is {report.found('two masses: |slope - (4.42)| as printed (R = 1)'):.1e} off",
    verdict=PARTLY,
    why="(4.33) is right; (4.42) leaves out ½ e₁ᵀ(K - Kᵀ)e₂, of either sign where kxy and kyx differ.",
)
report.finish()
