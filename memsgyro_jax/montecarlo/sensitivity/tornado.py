"""How each varied parameter moves the outputs, one at a time: by one gradient at the design, and by runs at both ends.

A difference between the two says that the response bends; a bar that is not larger than its standard error says that
the noise hides it. All points share the same noise, so most of it cancels in the differences.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from memsgyro_jax.base.axes import axes
from memsgyro_jax.base.display import Shown
from memsgyro_jax.base.errors import InputError
from memsgyro_jax.base.provenance import Settings
from memsgyro_jax.base.text import aligned
from memsgyro_jax.loop import noise
from memsgyro_jax.loop.loop import ClosedLoop
from memsgyro_jax.loop.scenario import AbstractProfile, Scenario, as_scenario

from ..batch import Plan, rows_of
from ..spread import Points, Root, Spread
from .outputs import Output, mean, place_of, standard_error
from .points import inputs_of, run_at


if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.axes import Axes


@dataclass(frozen=True, eq=False)
class Tornado(Shown):
    """Change of every output with one parameter at a time; prints itself.

    Args:
        outputs, units, inputs: names of outputs, their units, and paths of the varied parameters.
        design: outputs at the design, mean over the repeats (outputs,).
        low, high: change of the output with the parameter `sigmas` standard deviations below and above its design
            (outputs, inputs), mean over the repeats in which neither die was lost; NaN where there is none.
        std: standard error of the larger change (outputs, inputs).
        slope: change by `sigmas` standard deviations as the gradient at the design has it (outputs, inputs); NaN for
            outputs that only count.
        lost: share of dies lost at the low and at the high end (inputs, 2).
        sigmas, repeats: as they were asked for.
    """

    outputs: tuple[str, ...]
    units: tuple[str, ...]
    inputs: tuple[str, ...]
    design: Float[np.ndarray, " outputs"]
    low: Float[np.ndarray, "outputs inputs"]
    high: Float[np.ndarray, "outputs inputs"]
    std: Float[np.ndarray, "outputs inputs"]
    slope: Float[np.ndarray, "outputs inputs"]
    lost: Float[np.ndarray, "inputs 2"]
    sigmas: float
    repeats: int
    settings: Settings

    @property
    def status(self) -> str:
        """A sentence: what was run and what was lost."""
        dies = (2 * len(self.inputs) + 1) * self.repeats
        lost = round(float(np.sum(self.lost)) * self.repeats)
        return f"{dies} dies, {self.repeats} noises at each point, {lost} lost"

    def order(self, output: int) -> np.ndarray:
        """Inputs by the size of their effect on an output, the largest first."""
        size = np.fmax(np.abs(self.low[output]), np.abs(self.high[output]))
        return np.argsort(-np.nan_to_num(size), kind="stable")

    def __repr__(self) -> str:
        lines = [f"Change by ∓{self.sigmas:g} standard deviations of one parameter: {self.status}"]
        for k, (name, unit) in enumerate(zip(self.outputs, self.units, strict=True)):
            if not np.any(np.nan_to_num([self.low[k], self.high[k]])):
                lines.append(f"{name}: {self.design[k]:.4g} {unit} everywhere")
                continue
            lines.append(f"{name}: {self.design[k]:.4g} {unit} at the design")
            rows = [("  input", "low", "high", "standard error", "gradient")]
            for i in self.order(k):
                numbers = (self.low[k, i], self.high[k, i], self.std[k, i], self.slope[k, i])
                rows.append((f"  {self.inputs[i]}", *("-" if np.isnan(v) else f"{v:+.3g}" for v in numbers)))
            lines.append(aligned(rows))
        return "\n".join(lines)

    def to_xarray(self) -> "xr.Dataset":
        """Dataset over output and input."""
        import xarray as xr

        where = ("output", "input")
        return xr.Dataset(
            {name: (where, getattr(self, name)) for name in ("low", "high", "std", "slope")}
            | {"design": ("output", self.design), "lost": (("input", "end"), self.lost)},
            coords={"output": list(self.outputs), "input": list(self.inputs), "end": ["low", "high"],
                    "unit": ("output", list(self.units))},
            attrs={"sigmas": self.sigmas, "repeats": self.repeats, **self.settings.as_dict()},
        )  # fmt: skip

    def plot(self, ax: "Axes | None" = None, output: str | None = None) -> "Axes":
        """Bars of one output, the largest on top, with the gradient's prediction; returns the axes."""
        output = self.outputs[0] if output is None else output
        ax, k = axes(ax), place_of(output, self.outputs)
        order = self.order(k)[::-1]
        place = np.arange(len(order))
        for values, colour, offset, sign in ((self.low, "C0", 0.2, "-"), (self.high, "C1", -0.2, "+")):
            bars = np.nan_to_num(values[k, order])
            error = np.nan_to_num(self.std[k, order])
            label = f"{sign}{self.sigmas:g} σ"
            ax.barh(place + offset, bars, 0.4, xerr=error, color=colour, ecolor="0.4", label=label)
        if np.isfinite(self.slope[k]).all():
            ax.plot(self.slope[k, order], place - 0.2, "k|", ms=10, label=f"+{self.sigmas:g} σ by the gradient")
        ax.axvline(0.0, color="k", lw=0.8)
        ax.set_yticks(place, [self.inputs[i] for i in order])
        ax.set_xlabel(f"change of {output} [{self.units[k]}] from {self.design[k]:.3g}")
        ax.legend(loc="best", frameon=False)
        return ax


def tornado(
    loop: ClosedLoop,
    spread: Spread,
    scenario: Scenario | AbstractProfile | float = 1.0,
    *,
    sigmas: float = 1.0,
    repeats: int = 32,
    of: Sequence[Output] | None = None,
    seed: int = 0,
    **settings: Any,
) -> Tornado:
    """One parameter of the spread after the other at ∓`sigmas` standard deviations, the others at their design.

    Args:
        loop, spread, scenario: as in `sweep`; correlations do not matter here.
        sigmas: how far, in standard deviations of the parameter.
        repeats: noises at each point.
        of: outputs; without, errors of the rate, lost dies, and dies out of tolerance.
        seed: of the noise.
        settings: of the sweep (`sample_rate`, `duration`, `tolerance`, `progress`...).

    Raises:
        InputError: for a spread without variations, `sigmas` or `repeats` that are not positive, or settings that
            `sweep` refuses.
    """
    inputs = inputs_of(loop, spread)
    if not (sigmas > 0.0 and repeats >= 2):
        raise InputError(
            f"Arguments `sigmas` and `repeats` must be positive and at least 2, but are {sigmas:g} and {repeats}."
        )
    away = sigmas * np.eye(len(inputs))
    ends = np.concatenate([np.zeros((1, len(inputs))), -away, away])
    points = Points(np.repeat(ends, repeats, axis=0), np.tile(np.arange(repeats), len(ends)))
    lot, chosen, values = run_at(points, loop, spread, scenario, of=of, seed=seed, **settings)
    found = values.reshape(len(chosen), len(ends), repeats)
    status = np.asarray(lot.data["status"]).reshape(len(ends), repeats)
    change = found[:, 1:] - found[:, :1]
    moved, std = mean(change), standard_error(change)
    low, high = np.split(moved, 2, axis=1)
    plan = Plan(**{name: lot.data.attrs[name] for name in Plan._fields})
    return Tornado(
        outputs=tuple(o.name for o in chosen),
        units=tuple(o.unit for o in chosen),
        inputs=inputs,
        design=mean(found[:, :1])[:, 0],
        low=low,
        high=high,
        std=np.fmax(*np.split(std, 2, axis=1)),
        slope=slopes(loop, spread, as_scenario(scenario), plan, sigmas=sigmas, repeats=repeats, of=chosen, seed=seed),
        lost=np.mean(status[1:] != 0, axis=1).reshape(2, -1).T,
        sigmas=sigmas,
        repeats=repeats,
        settings=lot.settings,
    )


def slopes(
    loop: ClosedLoop, spread: Spread, scenario: Scenario, plan: Plan, *, sigmas: float, repeats: int,
    of: Sequence[Output], seed: int,
) -> Float[np.ndarray, "outputs inputs"]:  # fmt: skip
    """Derivative of each output's mean over the noises by each parameter, times `sigmas` standard deviations of it."""
    loop = loop.sampled_at(1.0 / plan.period)
    items, root = spread.resolved(loop), Root(loop, scenario)
    designs = [float(item.read(root)) for item in items]
    one = np.ones(1)  # standard deviation above
    above = [i.distribution.value(d, i.distribution.place(one))[0] for i, d in zip(items, designs, strict=True)]
    steps = sigmas * (np.asarray(above) - np.asarray(designs))
    words = noise.die_words(jax.random.key(seed), jnp.arange(repeats))
    smooth = [k for k, output in enumerate(of) if not output.counts]
    out = np.full((len(of), len(items)), np.nan)
    if smooth:
        chosen = [of[k] for k in smooth]
        out[smooth] = np.asarray(_gradient(root, items, jnp.asarray(steps), words, plan, chosen))
    return out


@eqx.filter_jit
def _gradient(
    root: Root, items: tuple, steps: Array, words: tuple, plan: Plan, of: Sequence[Output]
) -> Float[Array, "outputs inputs"]:
    def means(shift: Array) -> Array:
        values = [item.read(root) + part for item, part in zip(items, shift * steps, strict=True)]
        moved = eqx.tree_at(lambda r: [item.find(r) for item in items], root, values)
        rows = rows_of(moved.loop, moved.scenario, root.loop, words, plan)
        return jnp.stack([output.factor * jnp.nanmean(output.of(rows)) for output in of])

    none = jnp.zeros(len(items))
    # Forward mode, all parameters side by side: nothing of the trajectory is stored.
    return jax.vmap(lambda e: jax.jvp(means, (none,), (e,))[1], out_axes=1)(jnp.eye(len(items)))
