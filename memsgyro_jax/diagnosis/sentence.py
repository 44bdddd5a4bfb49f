"""What a diagnosis says in sentences."""

from collections.abc import Mapping, Sequence, Set

import numpy as np

from .findings import Accepted
from .fit import CaseFit
from .onset import Onset
from .result import UNEXPLAINED, Verdict


SLIGHT, NEAR = 0.01, 5.0  # of the χ² that the strongest effect takes, and times the noise: less is told apart from it
FAR_OFF = 2.0  # times the noise, in readings that an explanation did not have to explain
UNEVEN = "quadratic_stiffness"  # which a lock-in sees by its softening alone
DRIFT = "frequency_drift"  # in time, which a lone decay may not tell from a law
COURSE = "another course with temperature and bias voltage"  # where as many strengths as settings tell theirs


def sentence(
    verdict: Verdict,
    accepted: tuple[Accepted, ...],
    final: CaseFit,
    explained: list[bool],
    onset: Onset | None = None,
) -> str:
    """What was found, and what is left where something is; from which drive on, where a model fitted to those
    below explains them.
    """
    names = _by_weight(accepted, final)
    left = ", ".join(
        f"{e.name} ({e.role}, {e.rms:.3g} × noise)" for e, fine in zip(final.errors, explained, strict=True) if not fine
    )
    unused = _judged_only(final, explained)
    return {
        "nothing_missing": "The base model explains every record to its noise; no effect is missing.",
        "instrument_only": "With what the instrument does, the base model explains every record to its noise; no "
        "mechanical effect is missing.",
        "found": f"Missing was {names}; with {'it' if len(accepted) == 1 else 'them'} the model explains every record "
        "to its noise.",
        "cannot_tell": f"{names} would explain every record to its noise, but so would "
        + "; ".join(f"{' or '.join(a.confused_with)} in place of {a.label}" for a in accepted if a.confused_with)
        + "."
        + " A decay from another amplitude tells a law from a drift in time."
        * any(DRIFT in a.confused_with for a in accepted)
        + " A setting at which the temperature alone, or the bias alone, is another tells the two apart."
        * any(COURSE in a.confused_with for a in accepted)
        + " A waveform with its second harmonic tells a spring that is uneven from one that softens evenly."
        * any(other.startswith(UNEVEN) for a in accepted for other in a.confused_with),
        "partly_explained": f"{names} explains most of the misfit, but something unknown is left in {left}.{unused}"
        + (f" {_from_where(onset)}." if onset else ""),
        "unknown_effect": "Something is missing that no known effect explains"
        + (f". {_from_where(onset)}, beside that model" if onset else ": it shows")
        + f" in {left}.{unused}",
    }[verdict] + ("" if verdict in UNEXPLAINED else _excused(final) + _unheld(final))


def unseen_by_rest(before: CaseFit, final: CaseFit, verdict: Verdict) -> str:
    """Of effects that were found, that readings which were not fitted get no better by them; empty where they do, and
    where nothing was left to judge.
    """
    if verdict not in ("found", "cannot_tell"):
        return ""
    was, now = ([e for e in fit.errors if e.role == "validation"] for fit in (before, final))
    count = sum(e.count for e in now)
    chi2 = [sum(e.chi2 for e in errors) for errors in (was, now)]
    if not count or chi2[1] < chi2[0]:
        return ""
    levels = " and ".join(f"{np.sqrt(left / count):.3g}" for left in chi2[::-1])
    return (
        f" What was not fitted does not tell: it is at {levels} times its noise with and without. Another record like "
        "the fitted ones would."
    )


def _excused(final: CaseFit) -> str:
    """Of an explanation, which records far from it in what was not fitted it stands beside; else empty."""
    off = [e for e in final.errors if e.role == "validation" and e.rms > FAR_OFF and not e.explained]
    if not off:
        return ""
    where = ", ".join(f"{e.name} ({e.rms:.3g} × noise)" for e in off)
    have = "it has" if len(off) == 1 else "they have"
    return (
        f" What was not fitted of {where} is no part of that: the fit is too unsure of its numbers, or the noise too "
        f'little known, to be denied by it. Where {have} role = "fit" in the case, all rows are fitted.'
    )


def _unheld(final: CaseFit) -> str:
    """That an explanation says little, of records that do not hold a resonance of the device; else empty."""
    loose = [f"{m.value:.3g} ± {m.std:.2g} Hz" for m in final.modes if m.unit == "Hz" and m.value < m.std < np.inf]
    if not loose:
        return ""
    return f" That says little, as these records hold no resonance ({', '.join(loose)})."


def before_all(contradictions: Sequence[str]) -> str:
    """What to put right before anything else is believed, of records that contradict each other; else empty."""
    if not contradictions:
        return ""
    said = " ".join(f"{one[0].upper()}{one[1:]}" for one in contradictions)
    return f"The records contradict each other, which is to be put right before what follows counts. {said} "


def _from_where(onset: Onset) -> str:
    """From which drive on something unknown shows."""
    fitted = f"The drives up to {onset.upto} are explained to their noise by the model fitted to them alone"
    return f"{fitted}: what is unknown shows from {onset.since} on"


def _judged_only(final: CaseFit, explained: list[bool]) -> str:
    """What would help where all that is left lies in records none of whose readings were fitted; else empty."""
    fitted = {e.name for e in final.errors if e.role == "fit"}
    left = [e.name for e, fine in zip(final.errors, explained, strict=True) if not fine]
    if not left or fitted & set(left):
        return ""
    which, have = ("It was", "it has") if len(left) == 1 else ("They were", "they have")
    return f' {which} judged only: where {have} role = "fit" in the case, what is there counts for the verdict, too.'


def denied(best: CaseFit, tried: Sequence[str]) -> str:
    """Of something unknown, that what was tried explains all that was fitted, and which records, judged only, deny it;
    empty where it does not.
    """
    left = [error for error in best.errors if not error.explained]
    fitted = {error.name for error in best.errors if error.role == "fit"}
    if not (tried and left and best.leaves_noise) or fitted & {error.name for error in left}:
        return ""
    where = ", ".join(f"{error.name} ({error.rms:.3g} × noise)" for error in left)
    return (
        f" Of what was tried, {' with '.join(tried)} explains all records that were fitted; it is denied by {where} "
        "alone: look there first, whether it begins too early (`from`), or tells effective values and others peaks."
    )


def _by_weight(accepted: tuple[Accepted, ...], final: CaseFit) -> str:
    """The labels of effects, and apart those that explain next to nothing beside the strongest, and little of noise."""
    count = sum(error.count for error in final.errors if error.role == "fit")
    least = min(SLIGHT * max((a.chi2 for a in accepted), default=0.0), NEAR**2 * count)
    slight = ", ".join(a.label for a in accepted if a.chi2 < least)
    main = ", ".join(a.label for a in accepted if not a.chi2 < least)
    return main + f", and far weaker, within {NEAR:g} times the noise, {slight}" * bool(slight)


def of_noise(noise: Mapping[str, float], declared: Set[str], repeated: str = "") -> str:
    """A sentence on noise that is declared wrong, or was told wrong by the rows of a record; empty where none is. Where
    what is left is `repeated` from sweep to sweep, with the words why.
    """
    found = ", ".join(
        f"{size:.3g} times what is {'declared in' if record in declared else 'estimated from the rows of'} {record}"
        for record, size in noise.items()
    )
    if found and repeated:
        return (
            f" The noise would be {found}, but part of what is left is none: it repeats from sweep to sweep{repeated}."
        )
    return f" The noise is {found}: what is left there is white and depends on nothing." if found else ""
