"""What the instrument does to records, in words."""

from collections.abc import Sequence

import numpy as np

from memsgyro_jax.base.text import said_in
from memsgyro_jax.effects import TERMS
from memsgyro_jax.effects.lock_in_terms import InterferingLine
from memsgyro_jax.measurement.case import Case

from .findings import Accepted, told_with


def of_instrument(terms: Sequence[Accepted], rival: str, levels: int) -> str:
    """Sentences on what the instrument does, at how many levels of the drive; empty where it does nothing. Beside
    something unknown, which may have gone into its numbers, they are none of what is found first.
    """
    if not terms:
        return ""
    if all(np.isnan(s) for term in terms for s in term.std):
        return f" Beside it stands what an instrument may do, without proof: {', '.join(term.label for term in terms)}."
    also = f" These records cannot tell it from {rival}." if rival else ""
    if levels > 1 and {term.name for term in terms} <= {kind.name for kind in TERMS if kind.in_proportion}:
        also += f" What that explains grows in proportion at all {levels} levels of the drive: it is not the device."
    return f" The instrument: {'; '.join(map(_numbers_of, terms))}.{also}"


def _numbers_of(term: Accepted) -> str:
    if term.name == InterferingLine.name:  # of which the lines themselves are told
        return term.label
    every = zip(term.told(4), term.estimate, term.std, strict=True)
    held = [told for told, e, s in every if not abs(e) <= 1e-6 * s]
    beside = [f"{np.degrees(term.estimate[0]):.4g}°"] if term.unit == "rad" and len(term.estimate) == 1 else []
    beside += [f"{name} {value:.4g}" for name, (value, *_) in term.numbers.items()]
    return f"{term.label} {said_in(', '.join(held), term.unit)}{' (' + ', '.join(beside) + ')' if beside else ''}"


def of_lines(case: Case, terms: Sequence[Accepted], unexplained: bool) -> str:
    """A sentence on the lines that stand in records beside what the device does, with their sizes where they are among
    the `terms` of a fit; empty where they are not, unless something is left `unexplained`, and where there are none.
    """
    fitted = next((term for term in terms if term.name == InterferingLine.name), None)
    every = [(record, line) for record in case.records for line in record.interference(case)]
    if not every or (fitted is None and not unexplained):
        return ""
    sizes = [""] * len(every) if fitted is None else _sizes(fitted, case.channels)
    told = [
        f"in {record.name} {line.said(getattr(record, 'reference_frequency', None), case.readout.unit, size)}"
        for (record, line), size in zip(every, sizes, strict=True)
    ]
    return f" Beside what the device does, there stands {'; '.join(told)}."


def _sizes(fitted: Accepted, channels: int) -> list[str]:
    """The size of each line, in each channel that was recorded, from the two parts of its phasors."""
    parts, std = (np.reshape(values, (-1, channels, 2)) for values in (fitted.estimate, fitted.std))
    size = np.linalg.norm(parts, axis=2)
    spread = np.linalg.norm(parts * std, axis=2) / np.maximum(size, 1e-300)
    names = ("x ", "y ") if channels == 2 else ("",)
    return [
        ", ".join(name + told_with(*one) for name, *one in zip(names, *line, strict=True) if np.isfinite(one[1]))
        for line in zip(size, spread, strict=True)
    ]
