"""Prediction of a free decay piece by piece, each from its own unknown start."""

import dataclasses
from collections.abc import Callable, Iterator
from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from memsgyro_jax.base.linalg import inverse, product, small_root
from memsgyro_jax.device.conditions import Conditions

from ..envelope import FINEST, HARMONICS, LONGEST, SAMPLES, Course, Driven, run_samples, visited_samples
from ..first_order import Contribution, Inquiry, Instants, Periods
from ..lock_in import with_interference
from ..model import Model
from ..steady import FINENESS, as_seen, fundamental, reading_samples
from .base import BEYOND, Experiment, Noise
from .unknown_start import beside_start, start_that_leaves_least


SOLVES = 4  # Gauss-Newton steps towards the start of a piece
STRAIGHT = 2  # the same of a linear device: the second is taken where the first has ended


class FreeDecay(Experiment):
    """Readings of a device left alone, in pieces of equal length, each of which begins in its own unknown motion.

    The residual is that of the best start of every piece, and slopes are those beside it. Each piece therefore leaves
    2·axes less than its number of readings in χ². Short pieces keep a decay whose frequency changes by many cycles
    comparable with a model that does not know of it yet.

    Args:
        name: of the record.
        measured: waveforms (pieces·m, axes), or phasors of e^{iωt}.
        noise: how far they may lie from the prediction.
        start: displacement and velocity at the beginning of each piece to begin with, (pieces, 2·axes).
        period: between samples [s].
        surroundings: conditions per sample, with its time.
        frequency: of the reference of phasors [rad/s].
        substeps: integration steps per sample.
        nodes: at which a piece is integrated, evenly spaced from its first sample to its last, between which samples
            are interpolated; zero where samples are `period` apart.
        parts: of a first step that a step is one of.
    """

    driven: ClassVar[bool] = False
    slow: ClassVar[bool] = True
    swept: ClassVar[bool] = False

    name: str = eqx.field(static=True)
    measured: Array
    noise: Noise
    start: Float[Array, "pieces s"]
    period: Array
    surroundings: Conditions
    frequency: Array
    substeps: int = eqx.field(static=True, default=1)
    nodes: int = eqx.field(static=True, default=0)
    parts: int = eqx.field(static=True, default=1)

    @property
    def rows_stand_alone(self) -> bool:
        return False

    def predict(self, bench: Model) -> Array:
        """Every reading, from the start of its piece that suits the readings best."""
        starts, _ = self._solved(jax.lax.stop_gradient(bench))
        seen = jax.vmap(lambda s, c: self._readings(bench, s, c))(starts, self._by_piece(self.surroundings))
        return seen.reshape(self.measured.shape)

    def residual(self, bench: Model) -> Float[Array, " r"]:
        """Measured minus predicted in standard deviations, without what another start would change."""
        starts, slopes = self._solved(jax.lax.stop_gradient(bench))

        def one(start: Array, slope: Array, measured: Array, noise: Noise, now: Conditions) -> Array:
            return beside_start(noise.whiten(measured, self._readings(bench, start, now)).ravel(), slope)

        return jax.vmap(one)(starts, slopes, *self._pieces()).ravel()

    def nothing(self, bench: Model) -> Contribution | None:
        if self.nodes:
            return None
        turns = jnp.iscomplexobj(self.measured)
        forced = 2 * self.substeps * len(self.measured), *((HARMONICS + 1,) if turns else ()), bench.axes
        kind = complex if turns else float
        return Contribution.none(bench, (forced,), self.measured.shape, kind, self.start.shape[:1])

    def residual_beside(self, bench: Model, added: Contribution) -> tuple[Float[Array, " r"], Inquiry]:
        if jnp.iscomplexobj(self.measured):
            return self._phasors_beside(bench, added)
        starts, slopes = self._solved(jax.lax.stop_gradient(bench))
        pushed, seen = self._by_piece(added.forced[0].reshape(-1, 2, bench.axes)), self._by_piece(added.seen)
        quiet, measured, noise, now = jnp.zeros(bench.axes), *self._pieces()

        def one(start: Array, now: Conditions, push: Array, linear: tuple[Array, Array]) -> tuple[Array, Array]:
            states, fine, none = self._waveform(bench, start, now, linear, push)
            first = jax.tree.map(lambda leaf: leaf[0], now)
            return states, visited_samples(bench, states, none, none, self._grid(now)[0], fine, first)

        states, visited = jax.vmap(one)(starts, now, pushed, added.linear)
        kept = states[:, :: self.substeps]
        read = jax.vmap(jax.vmap(lambda s, c: bench.observe(s, quiet, quiet, c)))(kept, now)
        shown = jax.vmap(lambda v, c: with_interference(bench, v, c))(read, now) + seen
        left = jax.vmap(lambda m, n, p, s: beside_start(n.whiten(m, p).ravel(), s))(measured, noise, shown, slopes)
        moments = self._moments(bench, visited, jnp.repeat(jnp.arange(len(self.measured)), 2 * self.substeps))
        firsts = jax.tree.map(lambda leaf: leaf[:, 0], now)
        return left.ravel(), Inquiry((moments,), self._moments(bench, kept, slice(None)), firsts)

    def _phasors_beside(self, bench: Model, added: Contribution) -> tuple[Float[Array, " r"], Inquiry]:
        """`residual_beside` of phasors."""
        starts, slopes = self._solved(jax.lax.stop_gradient(bench))
        pushed = self._by_piece(added.forced[0].reshape(-1, 2, HARMONICS + 1, bench.axes))
        measured, noise, now = self._pieces()

        def one(start: Array, now: Conditions, push: Array, more: tuple[Array, Array]) -> tuple[Array, Array]:
            free, course, step, fine = self._turned(bench, start, now, more, push)
            held, begun = jax.lax.stop_gradient((free, course.start))  # moments are asked at, not differentiated
            return course.start[:: self.substeps], held.visited(begun, step, fine)

        kept, visited = jax.vmap(one)(starts, now, pushed, added.linear)
        quiet = jnp.zeros(bench.axes) + 0j
        read = jax.vmap(jax.vmap(lambda s, c: fundamental(bench, self.frequency, s, quiet, c)))
        shown = jax.vmap(lambda v, c: with_interference(bench, v, c))(read(kept, now) + self._by_piece(added.seen), now)
        left = jax.vmap(lambda m, n, p, s: beside_start(n.whiten(m, p).ravel(), s))(measured, noise, shown, slopes)

        def periods(states: Array, rows: Any, samples: int, harmonics: int) -> Periods:
            conditions = jax.tree.map(lambda leaf: leaf[rows], self.surroundings)
            return Periods(states, quiet[None], self.frequency[None], conditions, samples, harmonics)

        every = visited.reshape(-1, HARMONICS + 1, bench.size)
        forced = periods(every, jnp.repeat(jnp.arange(len(self.measured)), 2 * self.substeps), SAMPLES, HARMONICS)
        late = jax.vmap(lambda s, c: as_seen(s, bench.behind(self.frequency, c, s[0].real)))
        seen = late(kept.reshape(-1, HARMONICS + 1, bench.size), self.surroundings)
        firsts = jax.tree.map(lambda leaf: leaf[:, 0], now)
        asked = periods(seen, slice(None), reading_samples(bench, FINENESS[0]), 1)
        return left.ravel(), Inquiry((forced,), asked, firsts)

    def _moments(self, bench: Model, states: Array, rows: Any) -> Instants:
        """Moments of states (..., n) at some of the rows, under no force."""
        states = states.reshape(-1, bench.size)
        quiet = jnp.zeros((len(states), bench.axes))
        now = jax.tree.map(lambda leaf: leaf[rows], self.surroundings)
        return Instants(state=states, command=quiet, turn=quiet, conditions=now)

    @property
    def finer(self) -> "FreeDecay | None":
        """The same in steps half as long; `None` at the last, and where a fit could not keep them all."""
        more = self.parts < FINEST and 2 * len(self.measured) * self.substeps <= LONGEST
        return self._divided(2 * self.parts) if more else None

    @property
    def coarse(self) -> "FreeDecay":
        return self._divided(1)

    def _divided(self, parts: int) -> "FreeDecay":
        """The same with every first step in so many parts."""
        nodes = 1 + (self.nodes - 1) // self.parts * parts if self.nodes else 0
        return dataclasses.replace(self, substeps=self.substeps // self.parts * parts, nodes=nodes, parts=parts)

    def proposals(self, name: str) -> Iterator[tuple[str, Experiment]]:
        """Again as it was, and from a larger start."""
        yield f"repeat `{name}`", self
        larger = eqx.tree_at(lambda d: (d.measured, d.start), self, (BEYOND * self.measured, BEYOND * self.start))
        yield f"repeat `{name}` from {BEYOND:g} times the amplitude", larger

    def at(self, row: int) -> str:
        return f"at {float(np.asarray(self.surroundings.time)[row]):.4g} s"

    def _pieces(self) -> tuple[Array, Noise, Conditions]:
        """Readings, their noise (each reading's own, as rows may be left out) and conditions of every piece."""
        wide = jax.tree.map(lambda leaf: jnp.broadcast_to(leaf, self.measured.shape), self.noise)
        return self._by_piece(self.measured), self._by_piece(wide), self._by_piece(self.surroundings)

    def _by_piece(self, rows: Any) -> Any:
        """Rows (n, ...) as (pieces, m, ...)."""
        count = self.start.shape[0]
        return jax.tree.map(lambda leaf: leaf.reshape(count, -1, *leaf.shape[1:]), rows)

    def _solved(self, model: Model) -> tuple[Array, Array]:
        """The best start of every piece (pieces, s), and the slopes there of its residual (pieces, s, r) by unit."""

        def one(begin: Array, measured: Array, noise: Noise, now: Conditions) -> tuple[Array, Array]:
            omega = jnp.sqrt(jnp.max(model.device.stiffness))
            axes = model.axes
            q, v = begin[:axes], begin[axes:]
            size = jnp.sqrt(jnp.sum(q**2) + jnp.sum(v**2) / omega**2) + 1e-300
            units = size * jnp.concatenate([jnp.ones(axes), jnp.full(axes, omega)])

            def left(start: Array) -> Array:
                return noise.whiten(measured, self._readings(model, start, now)).ravel()

            bent = not model.is_bare
            return start_that_leaves_least(left, begin, units, steps=SOLVES if bent else STRAIGHT, far=1.0, bent=bent)

        begin = jax.lax.stop_gradient(self.start)
        return jax.vmap(one)(begin, *self._pieces())

    def _readings(self, model: Model, start: Array, now: Conditions) -> Array:
        """Readings (m, axes) of one piece."""
        quiet, (step, fine) = jnp.zeros(model.axes), self._grid(now)
        if not (jnp.iscomplexobj(self.measured) or self.nodes) and model.is_bare:  # a step of any length is exact
            states, _, _ = self._waveform(model, start, now, whole=True)
            return with_interference(model, jax.vmap(lambda s, c: model.observe(s, quiet, quiet, c))(states, now), now)
        if not jnp.iscomplexobj(self.measured):
            states, fine, none = self._waveform(model, start, now)
            states = self._at_samples(states, lambda: jax.vmap(model.derivative)(states, none, fine), step, now)
            return with_interference(model, jax.vmap(lambda s, c: model.observe(s, quiet, quiet, c))(states, now), now)
        free, course, step, _ = self._turned(model, start, now)
        slopes = lambda: product(free.operator, course.start) + free.load + course.here  # noqa: E731
        states = self._at_samples(course.start, slopes, step, now)
        shown = jax.vmap(lambda s, c: fundamental(model, self.frequency, s, free.force, c))(states, now)
        return with_interference(model, shown, now)

    def _turned(
        self,
        model: Model,
        start: Array,
        now: Conditions,
        more: tuple[Array, Array] | None = None,
        push: Array | None = None,
    ) -> tuple[Driven, Course, Array, Conditions]:
        """A piece in the frame of the reference: the model there, its course, its step and the conditions of each; with
        `more` and `push` as of a waveform.
        """
        first, (step, fine) = jax.tree.map(lambda leaf: leaf[0], now), self._grid(now)
        linear = _with_more(model.linear(first), more)
        vector = _turning_one_way(linear[0], start)
        turning = model.state_of(vector.real, first) + 1j * model.state_of(vector.imag, first)
        free = Driven(model, self.frequency, jnp.zeros(model.axes) + 0j, linear)
        begin = jnp.zeros((HARMONICS + 1, model.size), complex).at[1].set(turning)
        return free, free.run(begin, step, fine, push)[1], step, fine

    def _waveform(
        self,
        model: Model,
        start: Array,
        now: Conditions,
        more: tuple[Array, Array] | None = None,
        push: Array | None = None,
        *,
        whole: bool = False,
    ) -> tuple[Array, Conditions, Array]:
        """States at the beginning of every step of a piece, conditions and forces there; with `more` linear part, and
        accelerations `push` at both ends of each step, than the model has. In steps of a `whole` period, if asked for.
        """
        first, (step, fine) = jax.tree.map(lambda leaf: leaf[0], now), self._grid(now, whole)
        none, linear = jnp.zeros((jnp.asarray(fine.time).size, model.axes)), _with_more(model.linear(first), more)
        begin = model.state_of(start, first)
        return (
            run_samples(model, none, none, step, fine, first, start=begin, linear=linear, added=push),
            fine,
            none,
        )

    def _grid(self, now: Conditions, whole: bool = False) -> tuple[Array, Conditions]:
        """Step of the integration of a piece [s], and the conditions of each."""
        if whole:
            return self.period, now
        if not self.nodes:
            return self.period / self.substeps, jax.tree.map(lambda leaf: jnp.repeat(leaf, self.substeps), now)
        given = jnp.asarray(now.time)
        times = jnp.linspace(given[0], given[-1], self.nodes)
        return times[1] - times[0], jax.tree.map(lambda leaf: jnp.interp(times, given, leaf), now)

    def _at_samples(self, states: Array, slopes: Callable[[], Array], step: Array, now: Conditions) -> Array:
        """The states at the samples of a piece, from those of the integration and their slopes (Hermite's cubics)."""
        if not self.nodes:
            return states[:: self.substeps]
        time, slope = jnp.asarray(now.time), step * slopes()
        place = (time - time[0]) / step
        below = jnp.clip(jnp.floor(place).astype(int), 0, self.nodes - 2)

        def one(k: Array, s: Array) -> Array:
            ends = (1 + 2 * s) * (1 - s) ** 2 * states[k] + s**2 * (3 - 2 * s) * states[k + 1]
            return ends + s * (1 - s) * ((1 - s) * slope[k] - s * slope[k + 1])

        return jax.vmap(one)(below, place - below)


def _with_more(linear: tuple[Array, Array], more: tuple[Array, Array] | None) -> tuple[Array, Array]:
    return linear if more is None else (linear[0] + more[0], linear[1] + more[1])


def _turning_one_way(matrix: Float[Array, "n n"], start: Float[Array, " s"]) -> Array:
    """The analytic signal (s,) of a free motion s' = matrix·s from displacements and velocities: of each mode
    what turns in the sense of e^{iωt}, which is all that a lock-in shows, and whose real part is that motion.

    Its velocities are L = −Γ/2 + i·√(K − Γ²/4) times its displacements, where ΓK is KΓ but for what joins the dampings.
    """
    axes = start.size // 2
    stiffness, damping = -matrix[axes : 2 * axes, :axes], -matrix[axes : 2 * axes, axes : 2 * axes]
    turn, (q, v) = small_root(stiffness - damping @ damping / 4), (start[:axes], start[axes:])
    turned = q - 1j * (inverse(turn) @ (v + damping @ q / 2))
    return jnp.concatenate([turned, 1j * (turn @ turned) - damping @ turned / 2])
