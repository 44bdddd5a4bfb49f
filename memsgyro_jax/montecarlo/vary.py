"""One number of a loop or scenario that differs from die to die: its name, its law, and where it stands."""

import re
from dataclasses import dataclass
from typing import Any, NamedTuple

import equinox as eqx
import jax
from jaxtyping import Array

from memsgyro_jax.base.concrete import is_concrete
from memsgyro_jax.base.display import Shown, stated_at
from memsgyro_jax.base.errors import InputError
from memsgyro_jax.base.fields import Scalar
from memsgyro_jax.base.text import suggestion
from memsgyro_jax.device.carried import Effects
from memsgyro_jax.device.gyro import AbstractGyro
from memsgyro_jax.loop.loop import ClosedLoop
from memsgyro_jax.loop.scenario import Scenario

from .distributions import AbstractDistribution


DEVICE_PREFIX = "device."
_PROCESS, _MADE = "process", ("device", "readout")  # parts of a loop that a process makes


@dataclass(frozen=True, repr=False)
class Vary(Shown):
    """A number of the loop or scenario and its distribution.

    `path` names it from the loop, like `device.kxx`, `readout.opamp_offset.0`, `start.0`, as `from_modes` has it, like
    `device.quadrature` or `device.frequency.0`, an effect by number or label, like
    `device.effects.cubic_stiffness_x.strength`, or from the scenario, like `scenario.rate.level`.
    `process.over_etch` is that of the process which makes device and read-out, wherever they are given by their layout.
    """

    path: str
    distribution: AbstractDistribution

    def read(self, root: "Root") -> Array:
        """The design value; raises `InputError` when the path does not lead to a number, or would not vary it."""
        here = self.find(root)
        if not (eqx.is_inexact_array(here) and here.ndim == 0):
            raise InputError(f"A spread must name one number, but `{self.path}` is {type(here).__name__}.")
        if self.distribution.of_itself and is_concrete(here) and float(here) == 0.0:
            raise InputError(
                f"The spread of `{self.path}` must be given in its unit (`std`, or `low` and `high`), but is relative "
                "to a design value of zero, which would not vary."
            )
        return here

    def find(self, root: "Root") -> Any:
        """Whatever stands at the path, the first of `places`, or what the device calls so."""
        called = root.called(self.path) if isinstance(root, Root) else None
        return self.places(root)[0] if called is None else called

    def places(self, root: "Root") -> list[Any]:
        """Wherever the number stands: one that device and read-out share in both."""
        shared = self.path.startswith(f"{_PROCESS}.") and isinstance(root, Root)
        made = root.made_by_process() if shared else ()
        return [self._at(part, self.path) for part in made] or [self._at(root, self.path)]

    def spelled_out(self, device: AbstractGyro) -> str:
        """The path with an effect of `device` by its number, however it was called."""
        first, _, rest = self.path.partition(f"{DEVICE_PREFIX}effects.")
        called, dot, last = rest.partition(".")
        labels = [effect.label.replace(" ", "_") for effect in device.effects]
        found = [str(n) for n, label in enumerate(labels) if label == called.replace(" ", "_")]
        return f"{DEVICE_PREFIX}effects.{found[0]}{dot}{last}" if not first and found else self.path

    def _at(self, here: Any, path: str) -> Any:
        for part in path.split("."):
            try:
                here = here[int(part)] if re.fullmatch(r"\d+", part) else getattr(here, part.replace(" ", "_"))
            except (AttributeError, IndexError, TypeError):
                names = _names(here)
                known = suggestion(part, names, every=True) if names else "there is nothing"
                raise InputError(
                    f"A spread must name a number of the loop, but `{self.path}` has no `{part}` ({known})."
                ) from None
        return here


class Root(NamedTuple):
    """Where paths start: the parts of the loop, the process that makes some of them, and the scenario.

    No module: looking up a method of one flattens all that it holds, which was a third of drawing dies.
    """

    loop: ClosedLoop
    scenario: Scenario

    def __getattr__(self, name: str) -> object:
        if name.startswith("__"):
            raise AttributeError(name)
        shared = self.made_by_process() if name == _PROCESS else []
        return getattr(shared[0] if shared else self.loop, name)

    def made_by_process(self) -> list[Any]:
        """The parts of the loop that are given by their layout."""
        parts = [getattr(self.loop, name) for name in _MADE]
        return [part for part in parts if hasattr(part, _PROCESS)]

    def unit(self, path: str) -> str:
        """Of the number at a path; empty where nobody stated it."""
        names, name = self.loop.device.natural, path.removeprefix(DEVICE_PREFIX)
        return names.units[name] if names and name != path and name in names.units else stated_at(self, path)

    def called(self, path: str) -> Scalar | None:
        """What the device calls by a name of its designer; None for all else."""
        names, name = self.loop.device.natural, path.removeprefix(DEVICE_PREFIX)
        return names.of(self.loop.device)[name] if names and name != path and name in names.units else None

    def moved(self, items: "tuple[Vary, ...]", values: list[Any]) -> "Root":
        """With the value of each item wherever it stands; names of a designer last, so that they hold."""
        pairs = [(self.called(item.path) is None, item, value) for item, value in zip(items, values, strict=True)]
        own = [(item, value) for plain, item, value in pairs if plain]
        changes = {item.path.removeprefix(DEVICE_PREFIX): value for plain, item, value in pairs if not plain}
        moved = self
        if own:
            leaves, structure = jax.tree.flatten(self)
            marks: list[Any] = [object() for _ in leaves]  # by which numbers are told from what follows from them
            marked = jax.tree.unflatten(structure, marks)
            for item, value in own:
                for place in item.places(marked):
                    leaves[marks.index(place)] = value
            moved = jax.tree.unflatten(structure, leaves)
        device, names = moved.loop.device, self.loop.device.natural
        if changes and names:
            moved = eqx.tree_at(lambda root: root.loop.device, moved, names.into(device, changes))
        return moved


def _names(here: Any) -> list[str]:
    """What a part has that may be named: its numbers and its parts, and what a designer calls them."""
    if isinstance(here, Root):
        return [*_names(here.loop), *([_PROCESS] if here.made_by_process() else []), "scenario"]
    if isinstance(here, Effects):  # by their labels, and by number where several share one
        labels = [effect.label.replace(" ", "_") for effect in here]
        return [label if labels.count(label) == 1 else str(n) for n, label in enumerate(labels)]
    if isinstance(here, tuple | list):
        return [str(n) for n in range(len(here))]
    names = getattr(here, "natural", None)
    own = [
        name for name, value in getattr(here, "__dict__", {}).items() if eqx.is_inexact_array(value) or _is_part(value)
    ]
    return [*own, *(names.units if names else ())]


def _is_part(value: Any) -> bool:
    return isinstance(value, eqx.Module) or (isinstance(value, tuple) and any(map(eqx.is_inexact_array, value)))
