"""How strong must a missing effect be before a diagnosis finds it? Its power from 0 to 8 standard deviations.

At such strengths everything is linear: residual = sensitivity × strength + noise. So the sensitivities of the records
of the demonstration case are computed once, at the model that explains them, and thousands of residuals are drawn. In
each, every candidate is tested as a diagnosis does, with 5 % as the probability that anything is reported where nothing
is missing, all candidates taken together. Theory: the score of the missing effect follows a noncentral χ² with the
squared strength, and is found where it passes the threshold of the whole family. To be found is not to be told apart:
the dotted curves fall short where other candidates look much alike in these records.
"""

from dataclasses import replace
from importlib.resources import files

import matplotlib.pyplot as plt
import numpy as np
from _common import Report
from scipy import stats

from memsgyro_jax.base import runtime


runtime.configure()

from memsgyro_jax.diagnosis.findings import SIGMAS_SEEN  # noqa: E402
from memsgyro_jax.diagnosis.fit import fit_case  # noqa: E402
from memsgyro_jax.diagnosis.joint_residual import Joint  # noqa: E402
from memsgyro_jax.diagnosis.score import Score, basis, family_p_values, score  # noqa: E402
from memsgyro_jax.effects import CubicStiffness, Scanned, catalogue  # noqa: E402
from memsgyro_jax.measurement.case import load_case  # noqa: E402
from memsgyro_jax.measurement.readings import readings_of  # noqa: E402


LEVEL = 0.05
HIDDEN = ("quadratic_damping x", "cross_damping_asymmetry", "electrical_feedthrough x_to_y")
QUICK = ("sweep_x", "sweep_y")


def main() -> None:
    report = Report()
    draws = 2_000 if report.quick else 20_000
    scores = candidates(report.quick)
    report.row("candidates that these records can show", "-", len(scores))
    alone = threshold(scores)
    report.row("p-value that one candidate must reach alone", f"{LEVEL / len(scores):.2g} to {LEVEL:.2g}", alone)
    sigmas, rng = np.unique([*np.linspace(0.0, 8.0, 17), SIGMAS_SEEN]), np.random.default_rng(5)
    curves = {name: powers(scores, name, sigmas, alone, draws, rng) for name in HIDDEN}
    null = statistics(scores, np.zeros((draws, every(scores).shape[1])), rng)
    false = np.mean(smallest_p(scores, null) <= alone)
    report.row("false alarms where nothing is missing", LEVEL, false, f"± {np.sqrt(false * (1 - false) / draws):.2g}")
    theory = stats.ncx2.sf(stats.chi2.isf(alone, 1), 1, sigmas**2)
    for name, (found, first) in curves.items():
        at = int(np.flatnonzero(sigmas == SIGMAS_SEEN)[0])
        told = f"named first among all {first[at]:.3f}, at 6 sigma {first[sigmas == 6.0][0]:.3f}"
        report.row(f"{name}: found at {sigmas[at]:g} sigma", f"{theory[at]:.3f}", f"{found[at]:.3f}", told)
        report.row(f"{name}: largest distance from theory", 0.0, float(np.max(np.abs(found - theory))))
    report.picture(drawn(sigmas, theory, curves), "power")
    report.finish()


def candidates(quick: bool) -> dict[str, Score]:
    """Scores of all effects beside the model that explains the demonstration, by label, of those that are seen."""
    case = load_case(files("memsgyro_jax") / "demo")
    if quick:
        case = replace(case, records=tuple(case.record(name) for name in QUICK))
    right = fit_case(case, [CubicStiffness(axis=0)])
    others = [e for e in catalogue(2) if not isinstance(e, Scanned) and e.label != "cubic_stiffness x"]
    joint = Joint(right.model.with_effect(*others), readings_of(case))
    fitted = joint.fitted
    _, slopes = joint.linearise(joint.start, np.eye(joint.start.size), fitted)
    q = basis(slopes[:, np.concatenate([joint.base(), joint.of_effect(0)])])
    nothing = np.zeros(len(q))
    scores = {e.label: score(nothing, q, slopes[:, joint.of_effect(i + 1)]) for i, e in enumerate(others)}
    return {label: mine for label, mine in scores.items() if mine.size}


def threshold(scores: dict[str, Score]) -> float:
    """The p-value of one candidate alone at which the family as a whole reaches the level."""
    tried = np.geomspace(LEVEL / 100, LEVEL, len(scores))
    family = family_p_values([replace(s, p_value=p) for s, p in zip(scores.values(), tried, strict=True)])
    return float(np.interp(LEVEL, family, tried))


def every(scores: dict[str, Score]) -> np.ndarray:
    """Directions of all candidates side by side (r, sum of sizes)."""
    return np.concatenate([s.directions for s in scores.values()], axis=1)


def statistics(scores: dict[str, Score], shown: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """T of every candidate (draws, candidates), of noise on what is shown along all directions (draws, directions)."""
    whole = every(scores)
    values, vectors = np.linalg.eigh(whole.T @ whole)
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    along = shown + rng.standard_normal(shown.shape) @ root.T
    starts = np.cumsum([0, *(s.size for s in scores.values())])[:-1]
    return np.add.reduceat(along**2, starts, axis=1)


def smallest_p(scores: dict[str, Score], found: np.ndarray) -> np.ndarray:
    """The best candidate's p-value in every draw."""
    return np.min(p_alone(scores, found), axis=1)


def p_alone(scores: dict[str, Score], found: np.ndarray) -> np.ndarray:
    """p-values of every candidate alone (draws, candidates)."""
    return stats.chi2.sf(found, [s.size for s in scores.values()])


def powers(scores, name: str, sigmas: np.ndarray, alone: float, draws: int, rng) -> tuple[np.ndarray, np.ndarray]:
    """Per strength the share of draws in which the effect passes the threshold, and in which it is also the best."""
    mine, place = scores[name].directions[:, 0], list(scores).index(name)
    found, first = [], []
    for sigma in sigmas:
        shown = np.tile(sigma * (every(scores).T @ mine), (draws, 1))
        p = p_alone(scores, statistics(scores, shown, rng))
        passed = p[:, place] <= alone
        found.append(np.mean(passed))
        first.append(np.mean(passed & (np.argmin(p, axis=1) == place)))
    return np.array(found), np.array(first)


def drawn(sigmas: np.ndarray, theory: np.ndarray, curves):
    figure, ax = plt.subplots(figsize=(7.0, 3.6), layout="constrained")
    ax.plot(sigmas, theory, color="k", lw=1.0, label="theory")
    for number, (name, (found, first)) in enumerate(curves.items()):
        ax.plot(sigmas, found, "o", color=f"C{number}", ms=4, label=f"{name}: found")
        ax.plot(sigmas, first, ":", color=f"C{number}", lw=1.0, label="  and best of all")
    ax.axvline(SIGMAS_SEEN, color="0.6", lw=0.8, ls="--")
    ax.axhline(0.9, color="0.6", lw=0.8, ls="--")
    ax.set_xlabel("strength over its standard deviation")
    ax.set_ylabel("probability")
    ax.legend(frameon=False, fontsize="small")
    return figure


if __name__ == "__main__":
    main()
