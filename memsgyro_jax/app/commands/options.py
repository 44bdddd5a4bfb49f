"""What the commands that take a study file have in common: options that change the study, and where results go."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from memsgyro_jax.base.errors import InputError


if TYPE_CHECKING:  # most commands take no study, which is long to import
    from memsgyro_jax.loop.scenario import Recorded

    from ..study import Study


_SETTLE = 0.05  # s, as in the default study; the rest of a recorded rate counts as settled


def chosen_study(
    path: Path | None, rate_record: Path | None, effects: Path | None, *, block: int | None = None, **sweep: Any
) -> "tuple[Study, list[str]]":
    """The study of a command line, and what a person should know about it.

    `effects` is a file with effects of the user's own; `block` stands in section `[loop]`, `sweep` are entries of the
    section `[sweep]`; None leaves the study's own.
    """
    from memsgyro_jax.effects import load_effects

    from ..study import default_study, load_study, read_rate_record

    own = load_effects(effects, 2) if effects else ()
    if own and path is None:
        raise InputError("Option `--effects` must go with a study that names the effects, but no study was given.")
    study = default_study() if path is None else load_study(path, own)
    changes = {f"sweep.{name}": value for name, value in sweep.items() if value is not None}
    about: list[str] = []
    if block is not None:
        changes["loop.block"] = block
    if rate_record is not None:
        record = read_rate_record(rate_record)
        more, about = _following(record, rate_record, own_study=path is not None)
        changes = {**more, **changes}
    chosen = study.changed(changes) if changes else study
    return chosen, [*(chosen.notes if study.notes else []), *about]


def with_unit(given: str | None, unit: str) -> dict[str, object] | str | None:
    """A quantity of the command line as a study file would hold it: text with a unit of its own, or a number."""
    try:
        return None if given is None else {"value": float(given), "unit": unit}
    except ValueError:
        return given


def _following(record: "Recorded", path: Path, own_study: bool) -> tuple[dict[str, Any], list[str]]:
    """The run lasts as long as the record. The default study's filter, made for a constant rate, is told to follow."""
    from memsgyro_jax.loop.expectation import random_walk

    span = float(record.times[-1])
    changes: dict[str, Any] = {
        "scenario.rate": [{"kind": "record", "file": str(path.resolve())}],
        "sweep.duration": f"{span!r} s",
        "sweep.settle": f"{min(_SETTLE, 0.5 * span)!r} s",
    }
    notes = [f"The run lasts as long as the record, {span:g} s (`--duration` sets another time)."]
    walk = random_walk(record)
    if not own_study and walk > 0.0:
        changes["observer.process_noise.rate"] = f"{walk!r} rad^2/s^3"
        notes.append(
            f"The filter follows a rate that walks by {np.degrees(np.sqrt(walk)):.3g} deg/s per root second, as the "
            "record does (a study file sets `observer.process_noise.rate`)."
        )
    return changes, notes


def require_writable(*paths: Path | None) -> None:
    """Raise `InputError` where a result could not be written, before hours are spent on it; creates nothing."""
    for path in paths:
        if path is None:
            continue
        there = path
        while not there.exists() and there != there.parent:
            there = there.parent
        if path == there and path.is_dir():
            raise InputError(f"{path} must be a file, but is a folder.")
        if path.exists() and not path.is_file():
            raise InputError(f"{path} must be a file, but is a device or a pipe.")
        if there != path and not there.is_dir():
            raise InputError(f"{path} cannot be written, because {there} is no folder.")
        if not os.access(there, os.W_OK):
            raise InputError(f"{path} cannot be written: no permission for {there}.")


@contextmanager
def writing(where: Path, remedy: str) -> Iterator[None]:
    """Turns a full disk and the like into a sentence that names the place; `remedy` says how to go on."""
    try:
        yield
    except OSError as error:
        name = error.filename or where
        raise InputError(f"{name}: {error.strerror or error}; {remedy}.") from error
