"""Where the numbers of a loop stand in a study file: the way back from a tuned loop to text."""

from typing import Any, NamedTuple, get_args

import numpy as np

from memsgyro_jax.base.errors import InputError
from memsgyro_jax.base.quantity import FileSection, In, field_unit
from memsgyro_jax.effects.section import entries_of_effect
from memsgyro_jax.loop.loop import ClosedLoop

from .beliefs import Walks
from .classic import Classic, entries_of_classic, unit_of_classic


class NumberEntry(NamedTuple):
    """A dotted name in the file, its unit, and the paths of the loop's numbers that it holds, one or two."""

    name: str
    unit: str
    paths: tuple[str, ...]


_PLAIN = ("device", "readout", "filter", "observer", "controller", "actuators")
_NESTED = ("observer.fading", "observer.annealing", "observer.energy", "controller.energy", "controller.rocking",
           "observer.jump")  # fmt: skip
_AROUND = ("energy", "jump")


def entry_of(file: Any, names: tuple[str, ...], path: str) -> NumberEntry | None:
    """The entry that holds the number at `path` of a loop whose coefficients have `names`; None where none does.

    `file` is the `StudyFile`. Auxiliary tones are told apart by `tones_of`; numbers of a filter within an observer
    stand as the observer's.
    """
    if path.startswith("observer.filter."):
        found = entry_of(file, names, path.replace(".filter.", ".", 1))
        inside = [place.replace("observer.", "observer.filter.", 1) for place in found.paths] if found else []
        return found and found._replace(paths=tuple(inside))
    head, _, last = path.rpartition(".")
    walk = _walk_of(names, head, last)
    if walk:
        return walk
    if last.isdigit():
        section, _, field = _in_file(file, head).rpartition(".")
        pair = tuple(f"{head}.{i}" for i in range(len(names) if field == "adaptation" else 2))
    else:
        section, _, field = _in_file(file, path).rpartition(".")
        pair = (path,)
    if section in _PLAIN or section in _NESTED:
        part = file
        for name in section.split("."):
            part = getattr(part, name, None)  # a law may do without
        unit = field_unit(type(part), field) if isinstance(part, FileSection) else None
        return None if unit is None else NumberEntry(f"{section}.{field}", unit, pair)
    return None


def _in_file(file: Any, path: str) -> str:
    """Where a path of the loop leads in the file: what keeps an energy, tests for jumps, limits a force or looks ahead
    stands around the part that it belongs to.
    """
    part, _, rest = path.partition(".")
    if part not in ("observer", "controller"):
        return path
    for section in around(file, part):
        if not rest.startswith("inner."):
            return f"{section}.{rest}"
        rest = rest.removeprefix("inner.")
    return f"{part}.{rest}"


def around(file: Any, part: str) -> list[str]:
    """Sections of what stands around the observer or the law of the file, from without."""
    section = getattr(file, part, None)
    limited = ["actuators"] if part == "controller" and file.actuators is not None else []
    beside = [f"{part}.{name}" for name in _AROUND if getattr(section, name, None) is not None]
    return limited + beside + ([part] if getattr(section, "ahead", False) else [])


def _walk_of(names: tuple[str, ...], head: str, last: str) -> NumberEntry | None:
    """Process noise: coefficients by name, motion as position and velocity."""
    entry, table = "observer.process_noise", "observer.process_noise"
    if head.startswith("observer.inner."):
        table = "observer.inner.process_noise"
    if not head.startswith(f"{table}.") or not last.isdigit():
        return None
    kind, index = head.removeprefix(f"{table}."), int(last)
    paths: tuple[str, ...]
    if kind == "theta":
        field, paths = names[index], (f"{head}.{index}",)
    elif kind == "motion":
        field, first = ("position", 0) if index < 2 else ("velocity", 2)
        paths = tuple(f"{head}.{first + axis}" for axis in (0, 1))
    else:
        field, paths = "offset", tuple(f"{head}.{axis}" for axis in (0, 1))
    unit = field_unit(Walks, field)
    return None if unit is None else NumberEntry(f"{entry}.{field}", unit, paths)


def unit_at(file: Any, names: tuple[str, ...], path: str) -> str | None:
    """Unit of the number, or of all numbers, at `path` of a loop; coefficients may stand by their name."""
    prefix = "observer.process_noise."
    path = path.replace("observer.inner.process_noise.", prefix)
    name = path.removeprefix(f"{prefix}theta.") if path.startswith(f"{prefix}theta.") else path.removeprefix(prefix)
    if name != path and name in names:
        path = f"{prefix}theta.{names.index(name)}"
    inside = _in_file(file, path)
    if inside.startswith("controller.tones."):
        return _tone_units(file).get(path.rpartition(".")[2])
    if isinstance(file.controller, Classic) and unit_of_classic(inside):
        return unit_of_classic(inside)
    for candidate in (path, f"{path}.0"):
        entry = entry_of(file, names, candidate)
        if entry is not None:
            return entry.unit
    return None


def entries_of(file: Any, loop: ClosedLoop, paths: tuple[str, ...]) -> dict[str, Any]:
    """What `Study.changed` must be given so that the study has the numbers that `loop` has at `paths`.

    Raises `InputError` for a number that a study file does not hold.
    """
    names = loop.device.model.names
    changes: dict[str, Any] = {}
    for path in paths:
        inside = _in_file(file, path)
        if inside.startswith("controller.tones."):
            changes["controller.tones"] = _tones(file, loop)
            continue
        if isinstance(file.controller, Classic) and unit_of_classic(inside):
            changes |= entries_of_classic(_law(file, loop))
            continue
        added = loop.device.effects[len(loop.device.effects) - len(file.effects) :]
        if path.startswith("device.effects.") and int(path.split(".")[2]) >= len(loop.device.effects) - len(added):
            changes["effects"] = [entries_of_effect(effect) for effect in added]
            continue
        entry = entry_of(file, names, path)
        if entry is None:
            raise InputError(f"A study file holds no entry for `{path}`, so what was tuned cannot be written as one.")
        written = [In(entry.unit).write(_read(loop, place)) for place in entry.paths]
        changes[entry.name] = written[0] if len(written) == 1 else written
    return changes


def _law(file: Any, loop: ClosedLoop) -> Any:
    """The law of `[controller]` without what stands around it."""
    law: Any = loop.controller
    for _ in around(file, "controller"):
        law = law.inner
    return law


def _tones(file: Any, loop: ClosedLoop) -> list[dict[str, Any]]:
    units, law = _tone_units(file), _law(file, loop)
    return [
        {name: In(unit).write(float(np.asarray(getattr(tone, name)))) for name, unit in units.items()} | {"axis": axis}
        for axis, tones in zip("xy", law.tones, strict=True)
        for tone in tones
    ]


def _tone_units(file: Any) -> dict[str, str]:
    field = type(file.controller).model_fields.get("tones")
    kind = get_args(field.annotation)[0] if field else None
    return {name: field_unit(kind, name) or "1" for name in ("frequency", "amplitude", "phase")} if kind else {}


def _read(loop: ClosedLoop, path: str) -> float:
    here: Any = loop
    for part in path.split("."):
        here = here[int(part)] if part.isdigit() else getattr(here, part)
    return float(np.asarray(here))
