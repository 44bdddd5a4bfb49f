"""What every kind of sensitivity gives: figures of each output, which print, draw and become a Dataset alike."""

import abc
from collections.abc import Iterable
from dataclasses import dataclass, field, fields
from typing import TYPE_CHECKING, get_type_hints

import numpy as np
from jaxtyping import Int

from memsgyro_jax.base.display import Shown
from memsgyro_jax.base.errors import InputError
from memsgyro_jax.base.provenance import Settings


if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.axes import Axes

_DIMENSIONS = {"outputs": "output", "inputs": "input", "corners": "corner", "2": "end"}  # of a shape, in a Dataset
_HIDDEN = "0.8"  # grey of a bar that noise hides
_BROAD = 24  # letters of a name beyond which it is broken at its dots
Bars = tuple[np.ndarray, np.ndarray, str]  # length and error of each input's bar, and what they are


@dataclass(frozen=True, eq=False)
class Sensitivity(Shown, abc.ABC):
    """Figures of every output of a sweep at chosen points; prints itself.

    Args:
        outputs, units: names of the outputs, and units of their figures.
        inputs: paths of the varied parameters.
        settings: of the sweep.
        notes: what should be known of the runs, a sentence each: that they have not come to rest, say.
    """

    outputs: tuple[str, ...]
    units: tuple[str, ...]
    inputs: tuple[str, ...]
    settings: Settings
    notes: tuple[str, ...] = field(default=(), kw_only=True)

    @property
    @abc.abstractmethod
    def status(self) -> str:
        """A sentence: what was run and what was lost."""

    @abc.abstractmethod
    def _title(self) -> str:
        """What the figures are."""

    @abc.abstractmethod
    def _text(self, output: int) -> str:
        """The figures of an output."""

    def __repr__(self) -> str:
        notes = [f"note: {note}" for note in self.notes]
        return "\n".join([f"{self._title()}: {self.status}", *map(self._text, range(len(self.outputs))), *notes])

    def to_xarray(self) -> "xr.Dataset":
        """Dataset over output, input, and where there is one, corner or end (of a range or interval)."""
        import xarray as xr

        arrays, shapes = {}, get_type_hints(type(self))
        attributes = self.settings.as_dict() | ({"notes": "\n".join(self.notes)} if self.notes else {})
        for part in fields(self):
            value = getattr(self, part.name)
            if isinstance(value, np.ndarray):
                arrays[part.name] = tuple(_DIMENSIONS[name] for name in shapes[part.name].dim_str.split()), value
            elif isinstance(value, int | float):
                attributes[part.name] = value + 0  # netCDF knows no truth values
        found = xr.Dataset(arrays, {"output": list(self.outputs), "input": list(self.inputs)}, attributes)
        found = found.assign_coords(unit=("output", list(self.units)))
        return found.assign_coords(end=["low", "high"]) if "end" in found.dims else found

    def _place(self, output: str | None) -> int:
        """Where an output stands, the first where none is named; raises `InputError` for one not looked at."""
        if output is None:
            return 0
        if output not in self.outputs:
            raise InputError(f"Argument `output` must be one of {', '.join(self.outputs)}, but `{output}` was given.")
        return self.outputs.index(output)

    def _bars(self, ax: "Axes", order: Int[np.ndarray, " inputs"], pair: Iterable[Bars]) -> None:
        """Two bars for each input, in this order from below, grey where their error reaches zero; what is not a number
        has none.
        """
        from matplotlib.figure import Figure

        place, hidden = np.arange(len(order)), False
        for (length, error, label), colour, offset in zip(pair, ("C0", "C1"), (0.2, -0.2), strict=True):
            length, error = (np.nan_to_num(values[..., order]) for values in (length, error))
            within = (np.abs(length) <= np.atleast_2d(error)[0]) & (length != 0.0)
            colours = [_HIDDEN if inside else colour for inside in within]
            ax.barh(place + offset, length, 0.4, xerr=error, color=colours, ecolor="0.4")
            ax.plot([], [], "s", color=colour, label=label)
            hidden = hidden or bool(within.any())
        if hidden:
            ax.plot([], [], "s", color=_HIDDEN, label="within its error")
        ax.axvline(0.0, color="k", lw=0.8)
        ax.set_yticks(place, [_broken(self.inputs[i]) for i in order])
        if isinstance(ax.figure, Figure) and ax.figure.get_layout_engine() is None:
            ax.figure.set_layout_engine("constrained")  # long names of inputs keep their room


def _broken(path: str) -> str:
    """A path over as many lines as a narrow margin needs."""
    return path if len(path) <= _BROAD else path.replace(".", ".\n")
