"""Changes of a scenario that a run ends before: told in sentences, before the run."""

from collections.abc import Iterator

import numpy as np

from memsgyro_jax.base.concrete import is_concrete

from .scenario import AbstractProfile, Ramp, Recorded, Scenario, Step, Sum


def unreached(scenario: Scenario, duration: float) -> tuple[str, ...]:
    """A sentence for each step, ramp or recorded course of `scenario` that begins only after a run of `duration` [s]
    has ended; none of traced numbers.
    """
    found = []
    for name, profile in _named(scenario):
        for what, begin in _begins(profile):
            if begin >= duration:
                found.append(
                    f"The {what} of `scenario.{name}` at {begin:.4g} s lies beyond the end of the run at "
                    f"{duration:.4g} s and never comes; run longer (`duration`), or let it come earlier."
                )
    return tuple(found)


def _named(scenario: Scenario) -> Iterator[tuple[str, AbstractProfile]]:
    """Every profile by its name; of several that belong together, by its number."""
    for name, value in vars(scenario).items():
        parts = value if isinstance(value, tuple) else (value,)
        for number, profile in enumerate(parts):
            if profile is not None and is_concrete(profile):
                yield f"{name}.{number}" if len(parts) > 1 else name, profile


def _begins(profile: AbstractProfile) -> Iterator[tuple[str, float]]:
    """What a profile does only from a time [s] on, and this time; of dies that differ, the first."""
    if isinstance(profile, Sum):
        for part in profile.parts:
            yield from _begins(part)
    elif isinstance(profile, Step) and np.any(np.asarray(profile.before) != np.asarray(profile.after)):
        yield "step", float(np.min(profile.at))
    elif isinstance(profile, Ramp) and np.any(np.asarray(profile.slope) != 0.0):
        yield "ramp", float(np.min(profile.at))
    elif isinstance(profile, Recorded) and (moves := np.flatnonzero(np.diff(profile.values))).size:
        yield "recorded course", float(profile.times[moves[0]])
