"""Prediction of a rate table block by block: what a lock-in makes of a driven device while the table turns."""

from collections.abc import Iterator
from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Complex, Float

from memsgyro_jax.device.conditions import Conditions

from ..envelope import HARMONICS, SAMPLES, Driven
from ..first_order import Contribution, Inquiry, Periods
from ..lock_in import before_lock_in, through_lock_in
from ..model import Model
from ..on_table import OnTable
from ..rate_nodes import RateNodes
from ..steady import FINENESS, as_seen, fundamental, reading_samples, steady_state
from .base import BEYOND, Experiment, Noise


_SELDOM = 0.95  # of the rows turn more slowly than the fastest that a table is asked for


class RateTable(Experiment):
    """Phasors of consecutive lock-in blocks, each the mean over a whole number of drive cycles, or what a low pass that
    lets nothing of other harmonics through makes of it.

    The device has settled at the conditions of the first block when the record begins. Conditions are constant within a
    block.

    Args:
        name: of the record.
        time: middle of each block [s], (n,).
        measured: phasors (n, axes) [V].
        noise: how far they may lie from the prediction.
        frequency: of the drive [rad/s].
        force: amplitude per axis [N], (axes,).
        surroundings: conditions per block, the rate among them.
        step: time from block to block [s].
        rates: at which the linear part is made, for those of the surroundings.
        boxcar: whether each is a mean over whole cycles.
    """

    swept: ClassVar[bool] = False

    name: str = eqx.field(static=True)
    time: Float[Array, " n"]
    measured: Complex[Array, "n axes"]
    noise: Noise
    frequency: Array
    force: Float[Array, " axes"]
    surroundings: Conditions
    step: Array
    rates: RateNodes
    boxcar: bool = eqx.field(static=True, default=True)

    def predict(self, bench: Model) -> Complex[Array, "n axes"]:
        """Phasors of all channels and blocks."""
        return self._predicted(bench, None)[0]

    def predict_beside(self, bench: Model, added: Contribution) -> tuple[Complex[Array, "n axes"], Inquiry]:
        seen, driven, start, begun, means = self._predicted(bench, added)

        def periods(states: Array, conditions: Conditions, samples: int, harmonics: int) -> Periods:
            return Periods(states, driven.force[None], self.frequency[None], conditions, samples, harmonics)

        first = jax.tree.map(lambda leaf: leaf[:1], self.surroundings)
        twice = jax.tree.map(lambda leaf: jnp.repeat(leaf, 2), self.surroundings)
        held = jax.lax.stop_gradient(driven)  # moments are asked at, not differentiated
        ends = held.visited(begun, self.step, self.surroundings).reshape(2 * self.time.size, HARMONICS + 1, -1)
        begin = periods(start[None], first, FINENESS[0].samples, FINENESS[0].harmonics)
        late = jax.vmap(lambda s, c: as_seen(s, bench.behind(self.frequency, c, s[0].real)))(means, self.surroundings)
        read = periods(late, self.surroundings, reading_samples(bench, FINENESS[0]), 1)
        return seen, Inquiry((begin, periods(ends, twice, SAMPLES, HARMONICS)), read, self._base)

    def nothing(self, bench: Model) -> Contribution:
        rows, axes = self.measured.shape
        forced = (1, FINENESS[0].harmonics + 1, axes), (2 * rows, HARMONICS + 1, axes)
        several = () if self.rates.one else self.rates.rate.shape
        return Contribution.none(bench, forced, (rows, axes), complex, several)

    @property
    def _first(self) -> Conditions:
        return jax.tree.map(lambda leaf: leaf[0], self.surroundings)

    @property
    def _base(self) -> Conditions:
        """Where the linear part is made: those of the first block, at all rates that it takes."""
        if self.rates.one:
            return self._first
        return eqx.tree_at(lambda c: c.rate, self._first.rows(self.rates.rate.size), self.rates.rate)

    def _driven(self, bench: Model, added: Contribution | None) -> Driven | OnTable:
        """The model under the drive."""
        linear = bench.linear(self._base) if self.rates.one else jax.vmap(bench.linear)(self._base)
        linear = linear if added is None else added.beside(linear)
        driven = Driven(bench, self.frequency, self.force + 0j, linear)
        return driven if self.rates.one else OnTable(driven, self.rates)

    def _predicted(
        self, bench: Model, added: Contribution | None
    ) -> tuple[Array, Driven | OnTable, Array, Array, Array]:
        """Phasors; the model under the drive, the state that it begins in, those that its blocks do and their means."""
        driven, begin, ends = self._driven(bench, added), None, None
        if added is not None:
            begin, ends = added.forced[0][0], added.forced[1].reshape(self.time.size, 2, HARMONICS + 1, bench.axes)
        shown = before_lock_in(bench, self.measured[:1], self.frequency, driven.force, self._first)[0]
        near = jax.lax.stop_gradient(bench.motion(shown, self.frequency))
        start = steady_state(bench, self.frequency, driven.force, self._first, near, FINENESS[0], begin)
        first = start[: HARMONICS + 1]
        means, begun = driven.demodulated(first, self.step, self.surroundings, ends, self.boxcar)
        given = jax.vmap(lambda s, c: fundamental(bench, self.frequency, s, driven.force, c))(means, self.surroundings)
        given = given if added is None else given + added.seen
        seen = through_lock_in(bench, given, self.frequency, driven.force, given, self.surroundings)
        return seen, driven, start, begun, means

    def proposals(self, name: str) -> Iterator[tuple[str, Experiment]]:
        """Again as it was; rates up to the largest, known from a calibrated reference; fast ones; a stronger drive."""
        count, time, around = self.time.shape[0], np.asarray(self.time), self.surroundings
        most = float(np.max(np.abs(around.rate)))
        fastest = float(np.quantile(np.abs(around.angular_acceleration), _SELDOM))  # but for jumps
        yield f"repeat `{name}`", self
        if most > 0:
            phase, size = np.arange(count) / count, f"{np.degrees(most):.3g} deg/s"
            rate = most * np.sign(np.sin(2 * np.pi * 4 * phase)) * (phase < 0.5)
            rate = rate + most * np.sin(2 * np.pi * 10 * phase) * (phase >= 0.5)
            slope = np.gradient(rate, float(time[-1] - time[0]) / max(count - 1, 1))
            known = self._turning(rate, slope)
            known = eqx.tree_at(lambda t: t.surroundings.rate_trusted, known, jnp.ones(count))
            yield f"repeat `{name}` at known rate: steps and sines of {size}, calibrated", known
        if most > 0 and fastest > 0:
            pace = BEYOND * fastest / most
            shaken = self._turning(most * np.sin(pace * time), most * pace * np.cos(pace * time))
            yield f"repeat `{name}` with a rate sine of {size} at {pace / (2 * np.pi):.3g} Hz", shaken
        where = lambda t: (t.force, t.measured)  # noqa: E731
        stronger = eqx.tree_at(where, self, (BEYOND * self.force, BEYOND * self.measured))
        yield f"repeat `{name}` at {BEYOND:g} times the drive", stronger

    def at(self, row: int) -> str:
        return f"at {float(self.time[row]):.4g} s"

    def _turning(self, rate: np.ndarray, slope: np.ndarray) -> "RateTable":
        """The same with another rate (n,) [rad/s] and its slope [rad/s²]."""
        where = lambda t: (t.surroundings.rate, t.surroundings.angular_acceleration, t.rates)  # noqa: E731
        rates = RateNodes.of(rate, float(self.step))
        return eqx.tree_at(where, self, (jnp.asarray(rate), jnp.asarray(slope), rates))
