"""Which physics is missing from the model of a gyroscope? The whole way, from the records of a laboratory to a model
that predicts what it was never fitted to.

The records are the demonstration case that comes with the package. A simulator that shares no code with it made them
(`tests/lab`) and hid one effect: a cubic stiffness on x of 1.5e9 N/m³. Steps: fit the base model; see where it fails;
rank all known effects by what they could explain; add the best and fit again; look at the records that were never
fitted. `memsgyro diagnose demo` does the same on the command line.
"""

from dataclasses import replace
from importlib.resources import files

import matplotlib.pyplot as plt
import numpy as np
from _common import Report

from memsgyro_jax.base import runtime


runtime.configure()

from memsgyro_jax.diagnosis.compare import judged  # noqa: E402
from memsgyro_jax.diagnosis.diagnose import diagnose  # noqa: E402
from memsgyro_jax.diagnosis.result import Diagnosis  # noqa: E402
from memsgyro_jax.measurement.case import Case, load_case  # noqa: E402


HIDDEN = 1.5e9  # N/m³
QUICK = ("sweep_x", "sweep_y", "ringdown_x", "raw")


def main() -> None:
    report = Report()
    case = load_case(files("memsgyro_jax") / "demo")
    if report.quick:
        case = replace(case, records=tuple(case.record(name) for name in QUICK))
    found = diagnose(None, case, tell=lambda text: print("  ", text, flush=True))
    tell_the_story(found)
    claims(report, found)
    report.picture(falling_error(found), "error")
    report.picture(resonance(case, found), "resonance")
    report.finish()


def tell_the_story(found: Diagnosis) -> None:
    base, final = judged(found.base), judged(found.final)
    print("1. The base model, fitted to all records at once. Where does it fail?")
    print("\n".join(f"     {text}" for text in base.failures))
    print("2. What could explain it? The best candidates, by the χ² that each would explain:")
    for c in found.first[:5]:
        print(
            f"     {c.label:<26} {c.score:10.0f} = {100 * c.explained_share:5.1f} % of the misfit, p = {c.p_value:.1g}"
        )
    print("3. Add the best, fit again, until nothing more is significant:")
    for stage in found.steps:
        print(f"     {stage.added or 'base model':<26} χ²/dof {stage.chi2_per_dof:9.4g}   never fitted: "
              f"{stage.validation_error:8.4g} × noise")  # fmt: skip
    print(f"4. {found.sentence} {final.verdict}")


def claims(report: Report, found: Diagnosis) -> None:
    """What the simulator knows, and what noise alone would leave."""
    report.row("verdict", "found", found.verdict)
    report.row("effects", "cubic_stiffness x", ", ".join(a.label for a in found.accepted))
    for a in found.accepted:
        off = (a.estimate[0] - HIDDEN) / a.std[0]
        report.row(f"{a.label} [{a.unit}]", HIDDEN, a.estimate[0], f"± {a.std[0]:.2g}, off by {off:+.1f} of that")
    before = {(e.name, e.role): e.rms for e in found.base.errors}
    for e in found.final.errors:
        if e.role == "validation":
            told = f"base model {before[e.name, e.role]:.4g}; noise alone stays below {np.sqrt(e.gate):.4g}"
            report.row(f"{e.name}, never fitted: error / noise", 1.0, e.rms, told)


def falling_error(found: Diagnosis):
    """Error over noise of every record after every step."""
    figure, ax = plt.subplots(figsize=(8.0, 3.4), layout="constrained")
    labels = [f"{e.name}\n{'never fitted' if e.role == 'validation' else 'fitted'}" for e in found.base.errors]
    place = np.arange(len(labels))
    for shift, fit, name in ((-0.2, found.base, "base model"), (0.2, found.final, "with what was missing")):
        ax.bar(place + shift, [e.rms for e in fit.errors], 0.4, label=name, log=True, bottom=0.0)
    ax.axhline(1.0, color="k", lw=1.0, ls="--", label="noise")
    ax.set_ylim(0.5, None)
    ax.set_xticks(place, labels, fontsize="small")
    ax.set_ylabel("error / noise")
    ax.legend(frameon=False)
    return figure


def resonance(case: Case, found: Diagnosis):
    """The driven resonance at every drive level: measured, base model, final model."""
    record = case.record("sweep_x")
    number, hertz = case.records.index(record), record.frequency / (2 * np.pi)
    figure, ax = plt.subplots(figsize=(7.0, 3.4), layout="constrained")
    centre = hertz[np.argmax(np.abs(record.phasors[:, 0]))]
    for level, piece in enumerate(record.sweeps):
        rows = np.arange(record.rows)[piece]
        rows = rows[np.abs(hertz[rows] - centre) < 4.0]
        drive, told = 1e9 * record.drive[rows[0]], level == 0
        for fit, style, name in ((found.base, "--", "base model"), (found.final, "-", "with what was missing")):
            size = np.abs(fit.predicted(number)[rows, 0]) / drive
            ax.plot(hertz[rows], 1e3 * size, style, color=f"C{level}", lw=1.0, label=name if told else None)
        size = np.abs(record.phasors[rows, 0]) / drive
        ax.plot(hertz[rows], 1e3 * size, "o", color=f"C{level}", ms=4, label=f"measured at {drive:.0f} nN")
    ax.set_xlabel("drive frequency [Hz]")
    ax.set_ylabel("amplitude over drive [mV/nN]")
    ax.legend(frameon=False, fontsize="small")
    return figure


if __name__ == "__main__":
    main()
