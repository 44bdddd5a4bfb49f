"""Does a device of one's own run where only `[device]` is given? 24 devices far from the thesis', each by its modes.

Frequency, quality factor, split and mass are a Latin hypercube over their logarithms; every second device is coupled
by a turn of its stiffness and by cross damping, the others are designed without. Each is written as a study file that
holds `[device]` alone and swept; start, tone, sampling, duration, annealing and the filter's prior follow the device. A
device passes where the errors of its dies are 0.9 to 1.1 of their own bounds and the mean NEES is within its 99 %
interval; one that does not must say what does not fit, before the run or in its table.
"""

import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from _common import Report
from scipy import stats

import memsgyro_jax as mg
from memsgyro_jax.base import runtime


runtime.configure()

LOW = {"frequency [Hz]": 2e3, "Q": 100.0, "split [Hz]": 5.0, "mass [kg]": 1e-10}
HIGH = {"frequency [Hz]": 60e3, "Q": 1e5, "split [Hz]": 2e3, "mass [kg]": 1e-6}
TURN, CROSS = 0.35, 0.1  # rad, and share of the dampings, at most
STATES = 14


def devices(count: int) -> list[dict[str, float]]:
    draws = stats.qmc.LatinHypercube(6, rng=np.random.default_rng(14)).random(24)[:count]
    low, high = (np.log(list(ends.values())) for ends in (LOW, HIGH))
    found = []
    for number, draw in enumerate(draws.tolist()):
        device = dict(zip(LOW, np.exp(low + np.array(draw[:4]) * (high - low)).tolist(), strict=True))
        coupled = number % 2
        found.append(device | {"angle": coupled * TURN * draw[4], "cross": coupled * CROSS * (2.0 * draw[5] - 1.0)})
    return found


def study_of(device: dict[str, float], folder: Path) -> mg.Study:
    first = device["frequency [Hz]"]
    text = f"""[device]
kind = "single_mass"
mass = "{device["mass [kg]"]!r} kg"
frequency = ["{first!r} Hz", "{first + device["split [Hz]"]!r} Hz"]
quality_factor = {device["Q"]!r}
angle = "{device["angle"]!r} rad"
cross_damping = {device["cross"]!r}
"""
    (folder / "study.toml").write_text(text)
    return mg.load_study(folder / "study.toml")


def told(summary) -> str:
    """What the run says of what does not fit."""
    return "; ".join((*summary.notes, *summary.divergence.causes, *filter(None, [summary.hidden])))


def main() -> None:
    report = Report()
    dies = 256 if report.quick else 512
    figure, axes = plt.subplots(figsize=(6, 4), layout="constrained")
    low, high = stats.chi2.interval(0.99, STATES * dies)
    reached = silent = 0
    count = 2 if report.quick else 24
    report.row("devices", 24, count, "quick" if report.quick else "")
    for number, device in enumerate(devices(count)):
        with tempfile.TemporaryDirectory() as folder:
            study = study_of(device, Path(folder)).changed({"sweep.dies": dies})
        summary = mg.sweep(**study.sweep_arguments, bound_dies=dies).summary
        ratio, nees = summary.reached, summary.nees
        at_bound = 0.9 <= ratio.value <= 1.1
        consistent = nees is not None and low / dies <= nees <= high / dies
        said = told(summary)
        reached, silent = reached + (at_bound and consistent), silent + (not (at_bound and consistent) and not said)
        name = ", ".join(f"{key.partition(' ')[0]} {value:.3g}" for key, value in device.items() if value)
        report.row(
            f"{number}: {name}", "x 0.9 to 1.1, 14",
            f"x {ratio.value:.3f} ({ratio.low:.2f} to {ratio.high:.2f}), NEES {nees:.4g}",
            f"bound {np.degrees(summary.bound):.3g} deg/s" + (f"; {said}" if said else ""),
        )  # fmt: skip
        axes.errorbar(device["Q"], ratio.value, [[ratio.value - ratio.low], [ratio.high - ratio.value]],
                      fmt="o" if at_bound and consistent else "x", color="C0" if consistent else "C3")  # fmt: skip
    report.row("devices at their bound and consistent", "-", reached)
    report.row("devices that are neither and say nothing", 0, silent)
    axes.axhspan(0.9, 1.1, color="0.9")
    axes.set(xlabel="quality factor", ylabel="error over own bound", xscale="log")
    report.picture(figure, "devices")
    report.finish()


if __name__ == "__main__":
    main()
