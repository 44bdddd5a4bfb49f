"""Frequency sweep of a `Model` with any effects, each row at its own condition: drive, temperature, bias, rate."""

import dataclasses
from collections.abc import Iterator
from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Complex, Float, Int

from memsgyro_jax.base.few_at_a_time import over_rows
from memsgyro_jax.base.kept import kept
from memsgyro_jax.base.linalg import inverse
from memsgyro_jax.base.own_code import is_outside
from memsgyro_jax.base.plainly import PLAINLY
from memsgyro_jax.base.text import spoken
from memsgyro_jax.device.conditions import Conditions
from memsgyro_jax.effects.base import LockInEffect, SweepEffect

from ..bent_transient import Bent
from ..first_order import Contribution, Inquiry, Periods
from ..lock_in import BentCourse, RowsBefore, before_lock_in, bent_course, lock_in_rows, through_lock_in
from ..model import Model
from ..steady import (
    FINENESS,
    Fineness,
    as_seen,
    drive_waveform,
    fundamental,
    reading_samples,
    spectrum,
    steady_state,
    waveform,
)
from .base import BEYOND, Experiment, Noise
from .missing_force import receptance


AT_ONCE = 128  # rows of which the missing force is asked: as many for records of any length
_VARIED = 3e-3  # of the largest value: below it a condition was held
_COLD = 200.0  # K: below it nobody counts in °C
_LEVELS = 0.05  # of the largest drive: below it a drive is that of the others, as it was read


class HarmonicSweep(Experiment):
    """Settled phasors per row, V(t) = Re[(I + iQ) e^{iωt}] for a drive F cos ωt.

    Closed form where the model is linear, harmonic balance where it is not. The branch of a folded resonance is the one
    nearest to what was measured.

    Args:
        name: of the record.
        frequency: [rad/s], (n,).
        force: complex amplitude per axis [N], (n, axes).
        measured: phasors (n, axes) [V].
        noise: how far they may lie from the prediction.
        surroundings: conditions per row.
        near: displacement phasors (n, axes) [m], as they were read, that say which branch of a folded resonance is
            meant.
        direction: +1 where the frequency rose towards a row, −1 where it fell.
        before: phasors (n, axes) that were read in the row before [V]; `None` where each row stands alone.
        dwell: (n,) time since the row before [s], infinite where it is unknown; `None` for all.
        unsettled: (n,) one where a row was read before it had settled: it begins where the row before ended and rings
            down to its own motion, as its mode does; zero elsewhere; `None` for all.
        rows_before: which rows lie before each, where these are all of their sweeps; `None` where they are not.
        every, place: all rows of the sweeps, and where among them these are (n,); `None` where these are all.
        fineness: of the harmonic balance; `finer` is the next.
    """

    shows_modes: ClassVar[bool] = True
    reads_constants: ClassVar[bool] = False  # nor do amplitudes alone, which are real

    name: str = eqx.field(static=True)
    frequency: Float[Array, " n"]
    force: Complex[Array, "n axes"]
    measured: Complex[Array, "n axes"]
    noise: Noise
    surroundings: Conditions
    near: Complex[Array, "n axes"]
    direction: Float[Array, " n"]
    before: Complex[Array, "n axes"] | None = None
    dwell: Float[Array, " n"] | None = None
    unsettled: Float[Array, " n"] | None = None
    rows_before: RowsBefore | None = None
    every: "HarmonicSweep | None" = None
    place: Int[Array, " n"] | None = None
    fineness: Fineness = eqx.field(static=True, default=FINENESS[0])

    def predict(self, bench: Model) -> Complex[Array, "n axes"]:
        """Phasors of all channels."""
        return self._predicted(bench, None)[0]

    def predict_beside(self, bench: Model, added: Contribution) -> tuple[Complex[Array, "n axes"], Inquiry]:
        seen, states = self._predicted(bench, added)
        harmonics, samples = self.fineness
        earlier = jax.vmap(lambda w, s, c: as_seen(s, bench.behind(w, c, s[0].real)))
        late = earlier(self.frequency, states, self.surroundings)
        forced, read = (
            Periods(part, self.force, self.frequency, self.surroundings, count, harmonics)
            for part, count in ((states, samples), (late, reading_samples(bench, self.fineness)))
        )
        return seen, Inquiry((forced,), read, None, swept=True)

    def nothing(self, bench: Model) -> Contribution | None:
        swept = any(isinstance(effect, SweepEffect) for effect in bench.effects)
        rings = any(isinstance(effect, LockInEffect) and effect.rings for effect in bench.effects)
        if swept or _remembers(bench) or (self.dwell is not None and (rings or self.unsettled is not None)):
            return None  # what a row leaves to the next depends on what absent effects change
        rows, axes = self.measured.shape
        return Contribution.none(bench, ((rows, self.fineness.harmonics + 1, axes),), (rows, axes), complex)

    def _predicted(self, bench: Model, added: Contribution | None) -> tuple[Complex[Array, "n axes"], Array]:
        """Phasors of all channels, and the settled states."""
        if self.every is not None and self.place is not None and _remembers(bench):
            whole = dataclasses.replace(self.every, fineness=self.fineness)
            return jax.tree.map(lambda part: part[self.place], whole._predicted(bench, None))
        settled, states = self._settled(bench, added)
        seen = through_lock_in(
            bench, settled, self.frequency, self.force, self._before, self.surroundings, self.dwell, self.unsettled,
            self.rows_before, Bent(states, self.fineness) if self.bends(bench) else None,
        )  # fmt: skip
        return seen, states

    def course(self, bench: Model, parts: int) -> BentCourse:
        """How a device went from row to row of a sweep that `bends`, in so many parts of each."""
        settled, states = self._settled(bench, None)
        rows = lock_in_rows(self.frequency, self.force, self._before, self.surroundings, self.dwell)
        bent = Bent(states, self.fineness)
        return bent_course(bench, settled, rows, self.surroundings, self.unsettled, bent, parts)[2]

    def bends(self, bench: Model) -> bool:
        """Whether rows that had not settled go on as a device that is not linear does. Beside a user's own law, which
        may be so sharp that it asks 512 samples of a period, they ring down as the linear device.
        """
        linear = bench.is_linear or any(is_outside(type(effect)) for effect in bench.effects)
        return self.unsettled is not None and not linear

    @property
    def _before(self) -> Complex[Array, "n axes"]:
        """What was read in the row before each."""
        return self.measured if self.before is None else self.before

    def _settled(self, bench: Model, added: Contribution | None) -> tuple[Complex[Array, "n axes"], Array]:
        """Phasors of all channels before what a lock-in makes of them, and states, to which rows settle."""
        speeds = [effect.speed() for effect in bench.effects if isinstance(effect, SweepEffect)]
        speeds += [] if added is None else [added.speed]

        def row(
            omega: Array, force: Array, conditions: Conditions, near: Array, direction: Array, forced: Array | None
        ) -> tuple[Array, Array]:
            guess = near / bench.behind(omega, conditions)
            state = settled = steady_state(bench, omega, force, conditions, guess, self.fineness, forced)
            for speed in speeds:
                state = state.at[1].add(sweep_lag(bench, omega, force, conditions, direction * speed))
            return fundamental(bench, omega, state, force, conditions, self.fineness), settled

        rows = self.frequency, self.force, self.surroundings, self._shown(bench), self.direction
        settled, states = over_rows(row, *rows, None if added is None else added.forced[0])
        return settled if added is None else settled + added.seen, states

    def _shown(self, bench: Model) -> Complex[Array, "n axes"]:
        """`near` as the mass moves: before what a lock-in does, as amplitudes were never turned by one, and what
        read-out effects make of it, but for their delay.
        """
        if not jnp.iscomplexobj(self.measured):
            return jax.lax.stop_gradient(bench.moved(self.near, self.surroundings))
        volts = bench.scale * (1j * self.frequency[:, None]) ** bench.order
        shown = before_lock_in(bench, self.near * volts, self.frequency, self.force, self.surroundings)
        return jax.lax.stop_gradient(bench.moved(shown / volts, self.surroundings))

    @property
    def finer(self) -> "HarmonicSweep | None":
        """The same with more harmonics and samples; `None` at the last."""
        place = FINENESS.index(self.fineness) + 1
        return dataclasses.replace(self, fineness=FINENESS[place]) if place < len(FINENESS) else None

    @property
    def coarse(self) -> "HarmonicSweep":
        return dataclasses.replace(self, fineness=FINENESS[0])

    def proposals(self, name: str) -> Iterator[tuple[str, Experiment]]:
        """All rows again: as they were, the first drive after the last, over other bands, at the ends of what was
        varied, on the other axis, at other drives.
        """
        if self.every is not None or self.rows_before is not None:  # planned rows wait until all has settled
            yield from dataclasses.replace(self, rows_before=None, every=None, place=None).proposals(name)
            return
        around, held = self.surroundings, bool(np.ptp(np.asarray(self.frequency)) == 0.0)
        again = f"repeat `{name}`" if held else "repeat the frequency sweeps"
        yield again, self
        if (late := self._first_again()) is not None:
            yield "repeat the first drive level at the end of the record", late
        if not held:
            yield f"{again} over half the band, around the resonance", self._over(0.5)
            yield f"{again} over {BEYOND:g} times the band", self._over(BEYOND)
        for what, unit in (("temperature", "K"), ("bias_voltage", "V"), ("rate", "rad/s")):
            values = np.asarray(getattr(around, what))
            ends = float(values.min()), float(values.max())
            if np.ptp(values) > _VARIED * np.abs(values).max():
                half = np.where(np.arange(values.size) % 4 < 2, *ends)  # rows that are fitted are often every second
                moved = eqx.tree_at(lambda s, what=what: getattr(s.surroundings, what), self, jnp.asarray(half))
                low, high = (f"{end:.4g} K" if unit == "K" and end < _COLD else spoken(end, unit) for end in ends)
                yield f"{again} at {what.replace('_', ' ')}s of {low} and {high}, the ends of what was recorded", moved
        yield f"{again} at half the drive", self._driven(0.5)
        used = np.any(np.asarray(self.force) != 0, axis=0)
        if used.size == 2 and not used.all():
            turned = (self.force[:, ::-1], self.near[:, ::-1])
            yield f"{again} with the other axis driven", eqx.tree_at(lambda s: (s.force, s.near), self, turned)
        yield f"{again} at {BEYOND:g} times the drive", self._driven(BEYOND)

    def at(self, row: int) -> str:
        level = np.abs(np.asarray(self.force)).max(axis=1)
        where = f"near {spoken(float(self.frequency[row]) / (2 * np.pi), 'Hz')}"
        highest = np.ptp(level) > _LEVELS * level.max() and level[row] == level.max()
        return f"{where} at the highest drive" if highest else where

    def _driven(self, times: float) -> "HarmonicSweep":
        """The same at so many times the drive."""
        where = lambda s: (s.force, s.near, s.measured, *(() if s.before is None else (s.before,)))  # noqa: E731
        return eqx.tree_at(where, self, tuple(times * part for part in where(self)))

    @property
    def labels(self) -> np.ndarray:
        """Of each row: the one before enters as it was read."""
        told = np.stack([np.asarray(self.surroundings.record), np.asarray(self.surroundings.sweep)], axis=1)
        return told.astype(int)

    def _rows(self) -> tuple[np.ndarray, np.ndarray]:
        """Number of the single sweep that each row belongs to, and its displacement along the drive."""
        driven = np.argmax(np.abs(np.asarray(self.force)), axis=1)
        return np.unique(self.labels, axis=0, return_inverse=True)[1].ravel(), np.take_along_axis(
            np.asarray(self.near), driven[:, None], axis=1
        )[:, 0]

    def _over(self, times: float) -> "HarmonicSweep":
        """The same over a band so many times as wide about the strongest row of each sweep."""
        (sweep, motion), omega = self._rows(), np.asarray(self.frequency)
        moved, near = omega.copy(), np.array(self.near)
        for number in np.unique(sweep):
            rows = np.flatnonzero(sweep == number)
            peak = omega[rows[np.argmax(np.abs(motion[rows]))]]
            moved[rows] = np.maximum(peak + times * (omega[rows] - peak), peak / BEYOND)
            order = rows[np.argsort(omega[rows], kind="stable")]
            for axis in range(near.shape[1]):
                near[rows, axis] = np.interp(moved[rows], omega[order], np.asarray(self.near)[order, axis])
        return eqx.tree_at(lambda s: (s.frequency, s.near), self, (jnp.asarray(moved), jnp.asarray(near)))

    def _first_again(self) -> "HarmonicSweep | None":
        """The first of several drives of a record with a clock, once more after the last; `None` where there is none.

        It fills the first rows, and the others have no weight.
        """
        time, record = np.asarray(self.surroundings.time), np.asarray(self.surroundings.record)
        (sweep, _), level = self._rows(), np.abs(np.asarray(self.force)).max(axis=1)
        for number in np.unique(record):
            mine = np.flatnonzero(record == number)
            first = mine[sweep[mine] == sweep[mine[0]]]
            if np.ptp(level[mine]) > _LEVELS * level[mine].max() and np.ptp(time[mine]) > 0:
                rows = np.resize(first, time.size)
                again = jax.tree.map(lambda leaf, rows=rows: leaf[rows] if jnp.ndim(leaf) else leaf, self)
                later = again.surroundings.time + (time[mine].max() - time[first].min())
                again = eqx.tree_at(lambda s: s.surroundings.time, again, later)
                silent = jnp.where((np.arange(time.size) < first.size)[:, None], 1.0, jnp.inf)
                return eqx.tree_at(lambda s: s.noise.std, again, again.noise.std * silent)
        return None

    def missing(
        self, model: Model, mine: Bool[np.ndarray, " n"], predicted: Complex[np.ndarray, "m a"]
    ) -> tuple[Complex[np.ndarray, "m a"], Complex[np.ndarray, "m a"], Float[np.ndarray, "m a a"]]:
        """Of the rows that are `mine`, of which the model has `predicted` the phasors: the motion seen, the force [N]
        that it takes beyond the model, and |force per displacement|.
        """
        rows, count = np.arange(self.frequency.shape[0])[mine], self.frequency.shape[0]
        seen = np.array(self.measured)
        seen[mine] = predicted
        errors = model.motion(self.measured - seen, self.frequency)
        # What was not recorded moves as the model has it.
        errors = np.where(np.isfinite(getattr(self.noise, "std", 1.0)), errors, 0.0)
        shown = _shown(self, model)
        whole = jax.tree.map(np.asarray, (self.frequency, self.force, self.surroundings, shown, errors))
        parts = []
        for first in range(0, rows.size, AT_ONCE):
            some = np.resize(rows[first : first + AT_ONCE], min(AT_ONCE, count))
            asked = _missing(model, self.fineness, *jax.tree.map(lambda leaf, some=some: leaf[some], whole))
            parts.append(jax.tree.map(np.asarray, asked))
        motion, force, gain = (np.concatenate(part)[: rows.size] for part in zip(*parts, strict=True))
        return motion, force, gain


def _remembers(bench: Model) -> bool:
    """Whether rows further back enter what is read."""
    return any(isinstance(effect, LockInEffect) and effect.remembers for effect in bench.effects)


def _missing_of(
    model: Model, fineness: Fineness, frequency: Array, force: Array, surroundings: Conditions, near: Array,
    errors: Array,
) -> tuple[Array, Array, Array]:  # fmt: skip
    axes = model.axes

    def row(omega: Array, force: Array, conditions: Conditions, near: Array, error: Array):
        earlier = model.behind(omega, conditions)
        state = steady_state(model, omega, force, conditions, near / earlier, fineness)
        matrix, _ = model.linear(conditions)
        moved = state.at[1].add(_carried(matrix, omega, error / earlier))
        samples = fineness.samples
        command, states = drive_waveform(force, samples)[0], waveform(moved, samples)
        rates = jax.vmap(lambda s, u: model.derivative(s, u, conditions))(states, command)
        given = spectrum(rates, 1)[1, axes : 2 * axes]
        missing = (1j * omega * moved[1, axes : 2 * axes] - given) / jnp.abs(model.device.mobility)
        return moved[1, :axes], missing, jnp.abs(jnp.linalg.inv(receptance(model, matrix, omega)))

    return jax.vmap(row)(frequency, force, surroundings, near, errors)


def _shown_of(sweep: HarmonicSweep, model: Model) -> Complex[Array, "n axes"]:
    return sweep._shown(model)


_missing, _shown = (kept(function, PLAINLY) for function in (_missing_of, _shown_of))  # a few times for a case


def _carried(matrix: Array, omega: Array, error: Complex[Array, " a"]) -> Complex[Array, " n"]:
    """The state that goes with a displacement: velocity, and how the effects' own linear states follow."""
    axes = error.shape[0]
    motion = jnp.concatenate([error, 1j * omega * error])
    if matrix.shape[0] == 2 * axes:
        return motion
    own = matrix[2 * axes :]
    operator = 1j * omega * jnp.eye(own.shape[0]) - own[:, 2 * axes :]
    return jnp.concatenate([motion, jnp.linalg.solve(operator, own[:, : 2 * axes] @ motion)])


def sweep_lag(model: Model, omega: Array, force: Array, conditions: Conditions, beta: Array) -> Complex[Array, " n"]:
    """What a sweep whose frequency moves at `beta` [rad/s²] adds to the settled state; exactly zero at zero.

    With L = iω − A the response to a chirp is ∫₀^∞ e^{−Ls + iβs²/2}·b ds, here its asymptotic series
    iβL⁻³b + 3(iβ)²L⁻⁵b + 15(iβ)³L⁻⁷b: for sweeps that move little, √β against the half width of a resonance.
    """
    matrix, gain = model.linear(conditions)
    invert = inverse(1j * omega * jnp.eye(model.size) - matrix)
    term, total, factor = invert @ (gain @ force), 0.0, 1.0 + 0j
    for odd in (1.0, 3.0, 5.0):
        term, factor = invert @ (invert @ term), factor * odd * 1j * beta
        total = total + factor * term
    return total
