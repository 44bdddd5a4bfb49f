"""How each varied parameter moves the outputs, one at a time: by one gradient in the middle, and by runs at both ends.

A difference between the two says that the response bends; a bar that is not larger than its standard error says that
the noise hides it. All points share the same noise, so most of it cancels in the differences.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from memsgyro_jax.base.axes import axes
from memsgyro_jax.base.errors import InputError
from memsgyro_jax.base.files import finite
from memsgyro_jax.base.text import aligned
from memsgyro_jax.loop import noise
from memsgyro_jax.loop.loop import ClosedLoop
from memsgyro_jax.loop.scenario import AbstractProfile, Scenario, as_scenario

from ..batch import Plan, rows_of
from ..spread import Root, Spread
from .outputs import Output, mean, standard_error
from .points import inputs_of, repeated, run_at
from .result import Sensitivity


if TYPE_CHECKING:
    from matplotlib.axes import Axes


SCHEMA = "memsgyro-tornado/1"
HEAD = ("input", "low", "high", "standard error", "gradient")  # of `Tornado.rows`
ONE_NOISE = "one noise at each point and so no standard error"
_SPARE = 0.1  # of the larger bar: how far a gradient may lie outside both before that is told
_POINT = (
    "gradient {where} alone, which a whole step does not follow: take the bars. The response turns within the "
    "step, or the run still holds its start, whose lock changes with every small step."
)


@dataclass(frozen=True, eq=False, repr=False)
class Tornado(Sensitivity):
    """Change of every output with one parameter at a time.

    Args:
        design: outputs with every parameter in the middle of its distribution, mean over the repeats (outputs,).
        low, high: change of the output with the parameter `sigmas` standard deviations below and above that middle
            (outputs, inputs), mean over the repeats in which neither die was lost; NaN where there is none. One that is
            not normal stands where a normal one is as likely to be beyond: a uniform one of `sigmas` 1 at its 15.9 and
            84.1 % points, which `notes` tell.
        std: standard error of the larger change (outputs, inputs); NaN of one repeat.
        slope: change to the high end as the gradient in the middle has it (outputs, inputs); NaN for outputs that only
            count.
        lost: share of dies lost at the low and at the high end (inputs, 2).
        sigmas, repeats: as they were asked for.
        centred: whether the middle is the design: not where a distribution has a middle of its own.
    """

    design: Float[np.ndarray, " outputs"]
    low: Float[np.ndarray, "outputs inputs"]
    high: Float[np.ndarray, "outputs inputs"]
    std: Float[np.ndarray, "outputs inputs"]
    slope: Float[np.ndarray, "outputs inputs"]
    lost: Float[np.ndarray, "inputs 2"]
    sigmas: float
    repeats: int
    centred: bool = True

    @property
    def where(self) -> str:
        """Words for where `design` and `slope` are taken."""
        return "at the design" if self.centred else "in the middle of the spread"

    @property
    def status(self) -> str:
        dies = (2 * len(self.inputs) + 1) * self.repeats
        lost = round(float(np.sum(self.lost)) * self.repeats)
        noises = f"{self.repeats} noises at each point" if self.repeats > 1 else ONE_NOISE
        return f"{dies} dies, {noises}, {lost} lost"

    def order(self, output: int) -> np.ndarray:
        """Inputs by the size of their effect on an output, the largest first, those within a standard error last."""
        size = np.nan_to_num(np.fmax(np.abs(self.low[output]), np.abs(self.high[output])))
        return np.lexsort((-size, size < self.std[output]))

    def as_dict(self) -> dict[str, Any]:
        """Entries for JSON, the largest input of each output first; null where there is no number."""
        columns = {"low": self.low, "high": self.high, "standard_error": self.std, "gradient": self.slope}

        def inputs(k: int) -> list[dict[str, Any]]:
            lost = ({"lost_low": float(a), "lost_high": float(b)} for a, b in self.lost)
            rows = [
                {"name": name, **{key: float(values[k, i]) for key, values in columns.items()}, **ends}
                for i, (name, ends) in enumerate(zip(self.inputs, lost, strict=True))
            ]
            return [rows[i] for i in self.order(k)]

        told = [
            {"name": name, "unit": unit, "design": float(self.design[k]), "inputs": inputs(k)}
            for k, (name, unit) in enumerate(zip(self.outputs, self.units, strict=True))
        ]
        made = {"sigmas": self.sigmas, "repeats": self.repeats, "notes": list(self.notes), **self.settings.as_dict()}
        return finite({"schema": SCHEMA, **made, "outputs": told})

    def rows(self, output: int) -> list[tuple[str, ...]]:
        """Input, low, high, standard error and gradient as text, the largest first, a star behind a gradient that a
        whole step does not follow.
        """
        columns = [values[output] for values in (self.low, self.high, self.std, self.slope)]
        apart, found = self._apart(output), []
        for i in self.order(output):
            *bars, error, slope = ("-" if np.isnan(column[i]) else f"{column[i]:+.3g}" for column in columns)
            found.append((self.inputs[i], *bars, error.removeprefix("+"), f"{slope} *" if apart[i] else slope))
        return found

    def note(self, output: int) -> str:
        """What the stars say; empty without any."""
        return f"* {_POINT.format(where=self.where)}" if self._apart(output).any() else ""

    def moved(self, output: int) -> bool:
        """Whether any input moves the output at all."""
        return bool(np.any(np.nan_to_num([self.low[output], self.high[output]])))

    def _title(self) -> str:
        alone = "one parameter alone, whatever correlation the spread has"
        return f"Change by ∓{self.sigmas:g} standard deviations of {alone}"

    def _apart(self, output: int) -> Bool[np.ndarray, " inputs"]:
        """Where the gradient lies outside what both bars say, errors and a tenth of the larger one allowed for."""
        ends = np.stack([-self.low[output], self.high[output]])
        spare = 2.0 * np.nan_to_num(self.std[output]) + _SPARE * np.max(np.abs(ends), axis=0)
        slope = self.slope[output]
        return (slope < np.min(ends, axis=0) - spare) | (slope > np.max(ends, axis=0) + spare)

    def _text(self, output: int) -> str:
        design = f"{self.outputs[output]}: {self.design[output]:.4g} {self.units[output]}"
        if not self.moved(output):
            return f"{design} everywhere"
        rows = [("  input", *HEAD[1:]), *((f"  {name}", *cells) for name, *cells in self.rows(output))]
        note = self.note(output)
        return f"{design} {self.where}\n{aligned(rows)}" + (f"\n  {note}" if note else "")

    def plot(self, ax: "Axes | None" = None, output: str | None = None) -> "Axes":
        """Bars of one output, the largest on top, grey where the noise hides them, with the gradient's prediction, an
        arrow where that lies beyond the bars' axis, a star at the name where a whole step does not follow it; returns
        the axes.
        """
        ax, k = axes(ax), self._place(output)
        order = self.order(k)[::-1]
        ends = ((self.low, "-"), (self.high, "+"))
        self._bars(ax, order, [(values[k], self.std[k], f"{sign}{self.sigmas:g} σ") for values, sign in ends])
        if np.isfinite(self.slope[k]).all():
            label = f"+{self.sigmas:g} σ by gradient"
            _ticks(ax, self.slope[k, order], label)
        if (apart := self._apart(k)[order]).any():
            names = [tick.get_text() for tick in ax.get_yticklabels()]
            ax.set_yticks(ax.get_yticks(), [f"{n} *" if star else n for n, star in zip(names, apart, strict=True)])
            ax.plot([], [], "k", marker="$*$", ls="", label="the step does not follow the gradient")
        ax.set_xlabel(f"change of {self.outputs[k]} [{self.units[k]}] from {self.design[k]:.3g}")
        ax.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=2, frameon=False)  # where no bar lies
        return ax


def _ticks(ax: "Axes", slopes: Float[np.ndarray, " inputs"], label: str) -> None:
    """Gradients beside the bars, which alone set the axis: an arrow at its end for one beyond."""
    (low, high), place = ax.get_xlim(), np.arange(len(slopes)) - 0.2
    low, high = (end + 0.04 * sign * (high - low) for end, sign in ((low, -1.0), (high, 1.0)))
    inside = (slopes > low) & (slopes < high)
    ax.plot(slopes[inside], place[inside], "k|", ms=10, label=label)
    for beyond, end, mark, said in ((slopes >= high, high, "k>", True), (slopes <= low, low, "k<", False)):
        if beyond.any():
            more = "gradient beyond the axis" if said or not (slopes >= high).any() else None
            ax.plot(np.full(beyond.sum(), end), place[beyond], mark, ms=5, label=more, clip_on=False)
    ax.set_xlim(low, high)


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
    """One parameter of the spread after the other at ∓`sigmas` standard deviations, the others in the middle of their
    distributions. One that is not normal stands where a normal one is as likely to be beyond (see `Tornado`).

    `loop`, `spread` (correlations do not matter here), `scenario` and `settings` (`sample_rate`, `progress`...) are as
    in `sweep`, which runs `repeats` dies at each point with the noise of `seed`; one has no standard error. Looked at
    are the outputs `of` it: without, errors of the rate, lost dies, and dies out of tolerance.

    Raises `InputError` for a spread without variations, `sigmas` or `repeats` that are not positive, and settings that
    `sweep` refuses.
    """
    inputs = inputs_of(loop, spread)
    if not (sigmas > 0.0 and repeats >= 1):
        raise InputError(f"Arguments `sigmas` and `repeats` must be positive, but are {sigmas:g} and {repeats}.")
    away = sigmas * np.eye(len(inputs))
    places = np.concatenate([np.zeros((1, len(inputs))), -away, away])
    found = run_at(repeated(places, repeats), loop, spread, scenario, of, seed, settings)
    values, lost = found.at_places(repeats), found.lost(repeats)
    change = values[:, 1:] - values[:, :1]
    low, high = np.split(mean(change), 2, axis=1)
    plan = Plan(**{name: found.lot.data.attrs[name] for name in Plan._fields})
    around = _Ends.of(loop, spread, as_scenario(scenario), sigmas)
    return Tornado(
        **found.told_at(sigmas, loop, spread),
        inputs=inputs,
        design=mean(values[:, 0]),
        low=low,
        high=high,
        std=np.fmax(*np.split(standard_error(change), 2, axis=1)),
        slope=_slopes(loop, spread, as_scenario(scenario), plan, around, repeats=repeats, of=found.chosen, seed=seed),
        lost=lost[1:].reshape(2, -1).T,
        sigmas=sigmas,
        repeats=repeats,
        centred=around.centred,
    )


class _Ends(NamedTuple):
    """Of each varied parameter, in its unit: the loop's own number, the middle of its distribution, the high end."""

    designs: Float[np.ndarray, " inputs"]
    middles: Float[np.ndarray, " inputs"]
    highs: Float[np.ndarray, " inputs"]

    @classmethod
    def of(cls, loop: ClosedLoop, spread: Spread, scenario: Scenario, sigmas: float) -> "_Ends":
        root = Root(loop, scenario)
        items = spread.resolved(loop)
        designs = [float(item.read(root)) for item in items]
        laws = [item.distribution for item in items]
        at = np.array([0.0, sigmas])
        ends = [np.asarray(law.value(own, law.place(at))) for law, own in zip(laws, designs, strict=True)]
        return cls(np.array(designs), *np.transpose(ends))

    @property
    def centred(self) -> bool:
        """Whether every middle is the loop's own number, but for a thousandth of the step."""
        return bool(np.all(np.abs(self.middles - self.designs) <= 1e-3 * np.abs(self.highs - self.middles)))


def _slopes(
    loop: ClosedLoop, spread: Spread, scenario: Scenario, plan: Plan, around: _Ends, *, repeats: int,
    of: Sequence[Output], seed: int,
) -> Float[np.ndarray, "outputs inputs"]:  # fmt: skip
    """Derivative of each output's mean over the noises by each parameter in the middle, times its way to the end."""
    loop = loop.sampled_at(1.0 / plan.period, duration=plan.samples * plan.period)
    items, root = spread.resolved(loop), Root(loop, scenario)
    words = noise.die_words(jax.random.key(seed), jnp.arange(repeats))
    smooth = [k for k, output in enumerate(of) if not output.counts]
    out = np.full((len(of), len(items)), np.nan)
    if smooth:
        chosen = [of[k] for k in smooth]
        middles, steps = jnp.asarray(around.middles), jnp.asarray(around.highs - around.middles)
        out[smooth] = np.asarray(_gradient(root, items, middles, steps, words, plan, chosen))
    return out


@eqx.filter_jit
def _gradient(
    root: Root, items: tuple, middles: Array, steps: Array, words: tuple, plan: Plan, of: Sequence[Output]
) -> Float[Array, "outputs inputs"]:
    def means(shift: Array) -> Array:
        moved = root.moved(items, list(middles + shift * steps))
        rows = rows_of(moved.loop, moved.scenario, (root.loop, root.scenario), words, plan)
        rows = {name: jnp.moveaxis(value, -1, 0) for name, value in rows.items()}  # as a lot has them
        found = [output.of(moved.loop if output.of_loop else rows) for output in of]
        return jnp.stack([output.factor * jnp.nanmean(each) for output, each in zip(of, found, strict=True)])

    none = jnp.zeros(len(items))
    # Forward mode, all parameters side by side: nothing of the trajectory is stored.
    return jax.vmap(lambda e: jax.jvp(means, (none,), (e,))[1], out_axes=1)(jnp.eye(len(items)))
