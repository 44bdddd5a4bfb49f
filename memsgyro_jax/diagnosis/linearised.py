"""The program behind every fit: residual, its slopes, and what is added on the way; of its calls the last are kept."""

from collections import OrderedDict
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PyTree

from memsgyro_jax.base.concrete import strong
from memsgyro_jax.base.kept import kept
from memsgyro_jax.base.plainly import PLAINLY
from memsgyro_jax.base.threads import go_on
from memsgyro_jax.base.transforms import from_vector
from memsgyro_jax.measurement.experiments.base import Experiment, Readings
from memsgyro_jax.measurement.first_order import Contribution, Inquiry
from memsgyro_jax.measurement.model import Model

from .parameters import with_gain


# For the compiler. Where states and their slopes are both written step by step, it would fuse the two into one that
# writes all of them anew in each step: of 81000 steps 35 s in place of 0.04.
APART = {"xla_disable_hlo_passes": "cpu_multi_output_fusion"}
WIDTH, WIDER = 12, 16  # directions that one pass of a program differentiates; of one with numbers by row
_SPANNED = 1e-9  # of a direction: what sums of others may lack of it
SHORT = 100  # rows up to which optimising a program takes longer than the calls of a whole diagnosis


class Part(NamedTuple):
    """A model with some of the effects, what is free in it, and where its parameters stand among those of all; -1 of
    those of an absent effect that all do not have, which keep what they are at `rest`. So many directions `width` go
    through its program at once. Where a `gain` is held, of displacement per force at rest, 1/m follows k/m.
    """

    effects: tuple[int, ...]
    model: Model
    spec: PyTree
    places: np.ndarray
    rest: np.ndarray
    width: int
    gain: float | None = None

    def of(self, vector: np.ndarray) -> np.ndarray:
        """Its parameters at a vector of all."""
        return with_gain(np.where(self.places < 0, self.rest, vector[self.places]), self.gain)

    def along(self, directions: np.ndarray) -> np.ndarray:
        """Directions (k, p) among all parameters as directions among its own."""
        return with_gain(np.where(self.places < 0, 0.0, directions[:, self.places]), self.gain)


class Linear(NamedTuple):
    """Residual (r,) of an experiment at a vector, its slopes (w, r) along a block of directions (w, p), without one
    none, and what the prediction asked, where that is kept.
    """

    experiment: Experiment
    block: np.ndarray | None
    value: np.ndarray
    slopes: np.ndarray
    inquiry: Inquiry | None

    def along(self, block: np.ndarray | None) -> "Linear | None":
        """The same along another block, or any, where its directions are sums of those that are known."""
        if self.block is None or (block is not None and np.count_nonzero(np.any(block, axis=1)) > len(self.block)):
            return None
        if block is None or np.array_equal(self.block, block):
            return self
        if not np.all(np.isfinite(self.slopes)):  # sums would spread what is not
            return None
        scale = np.max(np.abs(self.block), axis=0)  # parameters differ by many powers of ten
        scale = np.where(scale > 0, scale, 1.0)
        wanted, known = block / scale, self.block / scale
        size = np.max(np.abs(known), axis=1, keepdims=True)
        size = np.where(size > 0, size, 1.0)
        sums = np.linalg.lstsq((known / size).T, wanted.T, rcond=_SPANNED)[0].T
        if np.any(np.abs(sums @ (known / size) - wanted) > _SPANNED * np.max(np.abs(wanted), axis=1, keepdims=True)):
            return None
        return self._replace(block=block, slopes=(sums / size.T) @ self.slopes)

    def without(self, rows: np.ndarray) -> "Linear":
        """The same where some of the residual (r,) have no weight."""
        return self._replace(value=np.where(rows, 0.0, self.value), slopes=np.where(rows, 0.0, self.slopes))


class Calls:
    """Calls of the programs, of which the last are kept: a fit ends where a ranking, and what tests it, begin.

    What a prediction asked, hundreds of megabytes of a long raw record, is kept of the last call of an experiment only.

    Args:
        kept: so many.
        fitted: experiments that there are programs with slopes for.
    """

    def __init__(self, kept: int, fitted: Sequence[Experiment]):
        self._kept: OrderedDict[tuple, Linear] = OrderedDict()
        self._last: OrderedDict[int, tuple[tuple, Linear]] = OrderedDict()  # by experiment, with what was asked
        self._most, self._fitted = kept, {_shape(e) for e in fitted}

    def residual(self, part: Part, vector: np.ndarray, experiment: Experiment) -> np.ndarray:
        """Residual (r,) at a vector of all parameters."""
        at = part.of(vector)
        if _shape(experiment) in self._fitted:  # a program exists; to compile one without slopes takes longer
            return self.linear(part, vector, experiment).value
        known = self._known(part, at, experiment)
        if known is None:
            go_on()
            value = np.asarray(_residual(at, part.model, part.spec, experiment))
            known = self._keep(part, at, Linear(experiment, None, value, np.zeros((0, value.size)), None))
        return known.value

    def linear(
        self, part: Part, vector: np.ndarray, experiment: Experiment, block: np.ndarray | None = None, *,
        asked: bool = False,
    ) -> Linear:  # fmt: skip
        """The same with slopes along a block of directions (w, p), as many as the part is wide, any where none is
        given; and with what was `asked`, if so.
        """
        at = part.of(vector)
        known = self._known(part, at, experiment, asked=asked)
        if known is not None and (along := known.along(block)) is not None:
            return along
        go_on()
        block = np.zeros((part.width, at.size)) if block is None else block
        none = nothing(experiment, part)
        value, slopes, inquiry = _linearise(at, block, none, part.model, part.spec, experiment)
        return self._keep(part, at, Linear(experiment, block, np.asarray(value), np.asarray(slopes), inquiry))

    def responses(self, part: Part, vector: np.ndarray, added: Contribution, readings: Readings) -> np.ndarray:
        """(k, r) what each of k contributions, side by side, adds to a residual."""
        at, experiment = part.of(vector), readings.experiment
        still, out = np.zeros((part.width, at.size)), np.zeros((len(added.seen), readings.size))
        acting = [np.any(leaf != 0, axis=tuple(range(1, leaf.ndim))) for leaf in jax.tree.leaves(added)]
        places = np.flatnonzero(np.any(acting, axis=0))
        for begin in range(0, places.size, part.width):
            go_on()
            mine = places[begin : begin + part.width]
            some = jax.tree.map(lambda leaf: lanes(leaf[mine], part.width), added)  # noqa: B023
            out[mine] = np.asarray(_linearise(at, still, some, part.model, part.spec, experiment)[1])[: mine.size]
        return out

    def _known(self, part: Part, at: np.ndarray, experiment: Experiment, *, asked: bool = False) -> Linear | None:
        key = id(experiment), part.effects, at.tobytes()
        if not asked:
            return self._kept.get(key)
        last, found = self._last.get(id(experiment), (None, None))
        return found if last == key else None

    def _keep(self, part: Part, at: np.ndarray, found: Linear) -> Linear:
        key = id(found.experiment), part.effects, at.tobytes()
        self._kept[key] = found._replace(inquiry=None)
        self._last[id(found.experiment)] = key, found
        for calls in (self._kept, self._last):
            while len(calls) > self._most:
                calls.popitem(last=False)
        return found


def compiled(function: Callable[..., Any], most: float = SHORT) -> Callable[..., Any]:
    """A function whose last argument is an `Experiment` as a program; for up to so many rows without optimising it."""
    optimised, plain, apart = kept(function), kept(function, PLAINLY), kept(function, APART)

    def call(*arguments: Any) -> Any:
        *others, experiment = arguments
        short = experiment.measured.shape[0] <= most and jax.default_backend() == "cpu"
        return (plain if short else apart if experiment.slow else optimised)(*others, strong(experiment))

    return call


def _shape(experiment: Experiment) -> tuple:
    """What decides which compiled program an experiment runs through."""
    leaves, structure = jax.tree.flatten(experiment)
    return structure, *(np.shape(leaf) for leaf in leaves)


def _predicted(vector: Array, model: Model, spec: PyTree, experiment: Experiment) -> Float[Array, " r"]:
    return experiment.residual(from_vector(vector, model, spec))


_residual = compiled(_predicted, np.inf)  # runs once or twice


@compiled
def _linearise(
    vector: Array, directions: Array, added: Contribution | None, model: Model, spec: PyTree, experiment: Experiment
) -> tuple[Array, Array, Inquiry | None]:
    """Residual, its slope along each of the directions and of what is added beside it, and what was asked."""

    def along(step: Array, more: Contribution | None) -> tuple[Array, Inquiry | None]:
        bench = from_vector(vector + step, model, spec)
        return (experiment.residual(bench), None) if more is None else experiment.residual_beside(bench, more)

    start = jnp.zeros_like(vector), jax.tree.map(lambda leaf: jnp.zeros_like(leaf[0]), added)
    # Forward mode with one primal and all directions side by side: nothing of the trajectory is stored.
    return jax.vmap(lambda *lane: jax.jvp(along, start, lane, has_aux=True), out_axes=(None, 0, None))(
        directions, added
    )


def nothing(experiment: Experiment, part: Part) -> Contribution | None:
    """Nothing added, as often as the part is wide."""
    return jax.tree.map(lambda leaf: np.zeros((part.width, *leaf.shape), leaf.dtype), experiment.nothing(part.model))


def lanes(leaf: np.ndarray, width: int) -> np.ndarray:
    """Up to `width` entries of the leading axis, and zeros in place of those that lack."""
    some = np.asarray(leaf)
    return np.concatenate([some, np.zeros((width - len(some), *some.shape[1:]), some.dtype)])
