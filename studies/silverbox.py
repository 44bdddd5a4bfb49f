"""Real data: what does an electronic resonator have that a linear one has not? `python studies/silverbox.py CASE`.

CASE is a folder with the Silverbox benchmark (T. Wigren and J. Schoukens, "Three free data sets for development and
benchmarking in nonlinear system identification", ECC 2013) as a measurement case: a multisine that is fitted and the
"arrow", noise of growing amplitude that never is. The rounds of a diagnosis are run one by one, and each is judged by
the error in mV on the first 32 000 samples of the arrow, within the amplitudes that were fitted, and on all of it. The
noise is estimated from the record, some 0.015 mV, and a real circuit has more in it than any catalogue: every round
finds something, and the error says what is worth having. Without CASE the study says so.
"""

from dataclasses import replace

import matplotlib.pyplot as plt
import numpy as np
from _common import Report

from memsgyro_jax.base import runtime


runtime.configure()

from memsgyro_jax.diagnosis.fit import CaseFit  # noqa: E402
from memsgyro_jax.diagnosis.joint_residual import Joint  # noqa: E402
from memsgyro_jax.diagnosis.search import Search, start_search  # noqa: E402
from memsgyro_jax.effects import Scanned, catalogue  # noqa: E402
from memsgyro_jax.measurement.case import Case, load_case  # noqa: E402
from memsgyro_jax.measurement.linear_start import starting_device  # noqa: E402
from memsgyro_jax.measurement.readings import model_of, readings_of  # noqa: E402


WITHIN = 32_000  # samples of the arrow that stay within the fitted amplitudes
BARS = ("about 6.6", "at most 0.60", "at most 0.33")  # mV: linear, with a cubic spring, with what comes next


def main() -> None:
    report = Report(data="folder of the Silverbox case")
    if report.data is None:
        print("Skipped: give the folder of the Silverbox case, for example `python studies/silverbox.py CASE`.")
        return
    samples, rounds = (6_000, 2) if report.quick else (20_000, 6)
    search = begin(shortened(load_case(report.data), samples))
    while len(search.steps) <= rounds and search.advance(search.rank()):
        pass
    fits = [step.fit for step in search.steps]
    names = ["linear", *(f"+ {step.added}" for step in search.steps[1:])]
    errors, whole = [arrow_error(fit, WITHIN) for fit in fits], [arrow_error(fit) for fit in fits]
    for number, (name, fit, error) in enumerate(zip(names, fits, errors, strict=True)):
        bar = BARS[number] if number < len(BARS) else "-"
        report.row(f"{name}: error on the arrow [mV]", bar, error, f"χ²/dof of the multisine {fit.chi2_per_dof:.4g}")
        report.row(f"{name}: beyond what was fitted too [mV]", "-", whole[number], "the whole arrow")
    report.row("the first effect", "cubic_stiffness x", search.steps[1].added if len(fits) > 1 else "none")
    report.picture(falling(names, errors), "error")
    report.picture(course(fits), "arrow")
    report.finish()


def begin(case: Case) -> Search:
    """The base model, fitted, with every effect of the catalogue that needs no scan as a candidate."""
    candidates = [effect for effect in catalogue(case.channels) if not isinstance(effect, Scanned)]
    model = model_of(case, starting_device(case)).with_effect(*candidates)
    return start_search(case, Joint(model, readings_of(case)), 0.05, (), lambda text: print("  ", text, flush=True))


def shortened(case: Case, samples: int) -> Case:
    """The beginning of the multisine, and the arrow."""
    return replace(case, records=(cut(case.record("multisine"), samples), case.record("arrow")))


def cut(record, count: int):
    rows = {name: getattr(record, name)[:count] for name in ("lines", "time", "forces", "signals", "rate")}
    return replace(record, **rows)


def arrow_residual(fit: CaseFit) -> np.ndarray:
    """Measured less predicted over the arrow [mV]; NaN while the unknown start dies out."""
    return 1e3 * (fit.case.records[1].signals - fit.predicted(1))[:, 0]


def arrow_error(fit: CaseFit, samples: int | None = None) -> float:
    """Root mean square [mV] over the first samples, or all."""
    return float(np.sqrt(np.nanmean(arrow_residual(fit)[:samples] ** 2)))


def falling(names: list[str], errors: list[float]):
    figure, ax = plt.subplots(figsize=(7.0, 3.4), layout="constrained")
    ax.semilogy(errors, "o-")
    ax.yaxis.set_major_formatter("{x:g}")
    ax.yaxis.set_minor_formatter("{x:g}")
    ax.tick_params(axis="y", which="both", labelsize="small")
    ax.set_xticks(range(len(names)), names, rotation=20, ha="right", fontsize="small")
    ax.set_ylabel("error on the arrow [mV]")
    return figure


def course(fits: list[CaseFit]):
    """The arrow, and what each model leaves of it."""
    figure, (upper, lower) = plt.subplots(2, 1, figsize=(7.0, 4.4), layout="constrained", sharex=True)
    record = fits[0].case.records[1]
    upper.plot(record.time, 1e3 * record.signals[:, 0], color="k", lw=0.3)
    upper.set_ylabel("arrow [mV]")
    for fit, name, shade in ((fits[0], "linear", "C1"), (fits[-1], "last round", "C0")):
        lower.plot(record.time, arrow_residual(fit), lw=0.3, label=name, color=shade)
    lower.set_ylabel("residual [mV]")
    lower.set_xlabel("time [s]")
    lower.legend(frameon=False)
    return figure


if __name__ == "__main__":
    main()
