"""The linear device behind phasors, without a guess: its equation of motion is linear in its parameters.

Every phasor obeys (K − ω² + iωD)·X = σ·F. Least squares on this equation, weighted with the response it implies
(Sanathanan and Koerner, IEEE Trans. Autom. Control 8 (1963) 56), lands near the optimum from any distance. The noise of
X, which stands in the columns too, leads an axis astray that hardly moves. Further rounds ask that what is left is
orthogonal to the columns as the device of the round before predicts them: these are free of noise (instrumental
variables: Young and Jakeman, Int. J. Control 29 (1979) 1).
"""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from memsgyro_jax.device.normalised import NormalisedDevice, is_positive

from .experiments.base import Phasors
from .one_resonance import ROUNDS, behind_an_instrument, of_modulus


LAST = 6
PAIRS = {1: ((0, 0),), 2: ((0, 0), (1, 1), (0, 1))}
_FEWEST = 8  # rows of one axis from which a gain that turns the phase, and a background, can be told too
_STANDS_OUT = 40.0
_EQUAL = 1e-9  # of a frequency, within which two are one
_SHOWN = 0.05  # of the squared motion, left by a device that the records show
_CLEAR = 100.0  # standard deviations of the largest reading of a record that tells a device by itself
_UNSHARED = 0.1  # of the squared motion, left by a device that several drives do not share
_SAME = 0.01  # of a drive level: repeats of it


Coefficients = tuple[np.ndarray, np.ndarray, float]  # stiffness, damping, mobility per mass


def device_of_phasors(offered: Sequence[Phasors]) -> NormalisedDevice | None:
    """The device that explains the phasors of all records best; `None` where none is offered or it would not be one,
    and where all are steady at one frequency, which shows of a gain and a distance from resonance only the quotient.
    """
    if not offered or _at_one_frequency(offered):
        return None
    rows = _Rows.of(offered)
    found = [of_modulus(*rows[:4]) if rows.modulus else None for rows in offered]
    if any(found):
        return next(one for one in found if one is not None)
    try:
        rounds = list(_rounds(rows))
        device, whole = rounds[min(ROUNDS, len(rounds) - 1)][1], np.sum(np.abs(rows.weight[:, None] * rows.motion) ** 2)
        least, best = min(rounds, key=lambda one: one[0])
        # Noise off the resonances, slow noise above all, may lead the rounds away from a device that was good.
        if least <= _SHOWN * whole or least < min(left for left, _ in rounds[: ROUNDS + 1]):
            device = best
        if rows.motion.shape[1] > 1 and _is_device(device) and _squares(rows, device) <= _SHOWN * whole:
            device = _likeliest(rows, device)
        steady = all(one.slope is None for one in offered)  # for which alone the following holds; else better than none
        turns = steady or not _is_device(device)
        if rows.motion.shape[1] == 1 and turns and len(rows.omega) >= _FEWEST:
            device = behind_an_instrument(device, rows.omega, rows.motion[:, 0], rows.force[:, 0], rows.weight)
        return NormalisedDevice(*device) if _is_device(device) else None
    except np.linalg.LinAlgError:  # nothing answers, or everything alike
        return None


def _at_one_frequency(offered: Sequence[Phasors]) -> bool:
    every = np.concatenate([one.omega for one in offered])
    return all(one.slope is None for one in offered) and bool(np.ptp(every) <= _EQUAL * np.max(every))


def is_seen(device: NormalisedDevice, offered: Sequence[Phasors]) -> bool:
    """Whether the resonance of one axis stands out of the noise by more than chance makes one: χ² falls by 40 when it
    is added to a background.
    """
    gained = 0.0
    for omega, motion, force, weight, modulus, *_ in offered:
        if modulus or motion.shape[1] > 1:
            return True
        stiffness, damping = np.asarray(device.stiffness)[0], np.asarray(device.damping)[0]
        response = 1.0 / (stiffness - omega**2 + 1j * omega * damping)
        columns = force[:, 0, None] * weight[:, None] * np.stack([np.ones(len(omega)), response], axis=1)
        seen = motion[:, 0] * weight
        for part, sign in ((columns[:, :1], 1.0), (columns, -1.0)):
            part = part / np.linalg.norm(part, axis=0)
            gained += sign * np.sum(np.abs(seen - part @ np.linalg.lstsq(part, seen, rcond=None)[0]) ** 2)
    return bool(gained > _STANDS_OUT)


def most_linear(rows: list[Phasors], device: NormalisedDevice | None) -> list[Phasors]:
    """The records, all of them where a device leaves little of their motion; where it leaves more, or there is none, of
    those that drive the same axes the ones driven least, if their resonance stands clear of its noise: where others
    bend over, these are the most linear. None of them where none stands clear.
    """
    if device is not None and is_shared(device, rows):
        return rows
    levels: dict[tuple, list[tuple[float, Phasors]]] = {}
    for row in rows:
        strengths = np.max(np.abs(row.force), axis=0)
        levels.setdefault((row.axis, *(strengths > 0.0)), []).append((float(np.max(strengths)), row))
    kept = []
    for offered in levels.values():
        clear = [level for level, row in offered if np.max(row.weight[:, None] * np.abs(row.motion)) > _CLEAR]
        lowest = min(clear, default=np.inf)
        kept += [row for level, row in offered if level <= (1.0 + _SAME) * lowest]
    return kept if len(kept) < len(rows) else rows


def is_shared(device: NormalisedDevice, rows: list[Phasors]) -> bool:
    """Whether a device leaves little of the motion of all rows."""
    return _left(device, rows) <= _UNSHARED


def misfit(offered: Phasors) -> float:
    """Squared deviation over noise, a half of a phasor's, of a record from the device that explains its phasors best,
    with a gain that turns nothing; infinite where none does.
    """
    try:
        return min(left for left, _ in _rounds(_Rows.of([offered]))) / (2.0 * offered.motion.size)
    except np.linalg.LinAlgError:
        return float("inf")


def _left(device: NormalisedDevice, rows: list[Phasors]) -> float:
    """The share of the squared motion, weighted with its noise, that a device leaves of records of all axes."""
    entries = np.asarray(device.stiffness), np.asarray(device.damping), float(device.mobility)
    left = whole = 0.0
    for row in rows:
        if row.modulus or row.axis is not None:
            continue
        left += float(np.sum(row.weight[:, None] ** 2 * np.abs(_Rows.of([row]).off(entries)) ** 2))
        whole += float(np.sum(row.weight[:, None] ** 2 * np.abs(row.motion) ** 2))
    return left / whole if whole > 0.0 else 0.0


def _is_device(device) -> bool:
    """Whether it is pushed back and slowed down whichever way it moves."""
    return all(is_positive(np.asarray(entries)) for entries in device[:2])


def _responses(device, omega: np.ndarray, axes: int) -> np.ndarray:
    """Displacement per equation error at each frequency (n, axes, axes)."""
    turn = 1j * omega
    if axes == 1:
        return np.linalg.inv((device[0] + turn[:, None] ** 2 + turn[:, None] * device[1])[:, :, None])
    x, y = (device[0][axis] + turn**2 + turn * device[1][axis] for axis in range(2))
    across = device[0][2] + turn * device[1][2]
    determinant = x * y - across**2  # written out, as a library takes ten times as long for thousands of two by two
    if not determinant.all():
        raise np.linalg.LinAlgError("Singular matrix")
    made = np.array([[y, -across], [-across, x]]) / determinant
    return np.moveaxis(made, -1, 0)


class _Rows(NamedTuple):
    """Phasors of displacement, velocity, acceleration and force (n, axes) at `omega`; `weight` (n,) of the first."""

    omega: np.ndarray
    motion: np.ndarray
    slope: np.ndarray
    bend: np.ndarray
    force: np.ndarray
    weight: np.ndarray

    @classmethod
    def of(cls, offered: Sequence[Phasors]) -> "_Rows":
        parts = ((p.omega, p.motion, *p.derivatives, p.force, p.weight) for p in offered)
        return cls(*map(np.concatenate, zip(*parts, strict=True)))

    def off(self, device: Coefficients, response: np.ndarray | None = None) -> np.ndarray:
        """By how much the motion lies off what a device, of a `response` that is made where none is given, makes of the
        force (n, axes).
        """
        if response is None:
            response = _responses(device, self.omega, self.motion.shape[1])
        stiffness, damping = _matrix(device[0]), _matrix(device[1])
        error = self.motion @ stiffness + self.slope @ damping + self.bend - device[2] * self.force
        return np.einsum("nij,nj->ni", response, error)

    def columns(self) -> np.ndarray:
        """Those of the equation of motion, linear in stiffness, damping and mobility (n, axes, unknowns)."""
        axes = self.motion.shape[1]
        pairs = PAIRS[axes]
        columns = np.zeros((self.omega.size, axes, 2 * len(pairs) + 1), complex)
        for place, (i, j) in enumerate(pairs):
            for row, column in {(i, j), (j, i)}:
                columns[:, row, place] = self.motion[:, column]
                columns[:, row, len(pairs) + place] = self.slope[:, column]
        columns[:, :, -1] = -self.force
        return columns

    def less(self, motion: np.ndarray) -> "_Rows":
        """Without a part of the motion."""
        turn = 1j * self.omega[:, None]
        return self._replace(
            motion=self.motion - motion, slope=self.slope - turn * motion, bend=self.bend - turn**2 * motion
        )


def _rounds(rows: _Rows) -> Iterator[tuple[float, Coefficients]]:
    """Device after device, and the squared motion that each leaves, infinite for what is none: `ROUNDS` of least
    squares behind the first, then as many of instrumental variables.
    """
    axes, columns = rows.motion.shape[1], rows.columns()
    device = _solve(rows, columns, (rows.weight / rows.omega**2)[:, None, None] * np.eye(axes))
    with np.errstate(over="ignore", invalid="ignore"):
        for turn in range(2 * ROUNDS + 1):
            response = _responses(device, rows.omega, axes)
            off = rows.off(device, response)
            left = float(np.sum(np.abs(rows.weight[:, None] * off) ** 2))
            yield (left if np.isfinite(left) and _is_device(device) else np.inf), device
            if not np.isfinite(response).all() or turn == 2 * ROUNDS:
                return
            # What an error of one axis' equation does to both channels: at a resonance of x that of y does little.
            weights = (rows.weight[:, None] * np.linalg.norm(response, axis=1))[..., None] * np.eye(axes)
            device = _solve(rows, columns, weights, rows.less(off).columns() if turn >= ROUNDS else None)


def _likeliest(rows: _Rows, device: Coefficients) -> Coefficients:
    """The device that leaves least, from one that leaves little: what errors of both equations do to a channel belongs
    together, or coupled axes are told half as well as they could be.
    """
    columns = rows.columns()
    for _ in range(LAST):
        response = _responses(device, rows.omega, rows.motion.shape[1])
        off = rows.off(device, response)
        nearer = _solve(rows, columns, rows.weight[:, None, None] * response, rows.less(off).columns())
        if not _is_device(nearer) or _squares(rows, nearer) > _squares(rows, device):
            break
        device = nearer
    return device


def _squares(rows: _Rows, device: Coefficients) -> float:
    """The squared motion that a device leaves."""
    return float(np.sum(np.abs(rows.weight[:, None] * rows.off(device)) ** 2))


def _solve(rows: _Rows, columns: np.ndarray, weight: np.ndarray, instrument: np.ndarray | None = None) -> Coefficients:
    """The device whose equation, of `columns`, leaves what is orthogonal to those of `instrument`, of another motion:
    least squares with `None`; `weight` (n, axes, axes) is what makes noise of its errors.
    """
    left, right = _weighted(columns, weight), _weighted(-rows.bend[..., None], weight)[:, 0]
    size = np.linalg.norm(left, axis=0)
    size = np.where(size > 0, size, 1.0)
    left = left / size
    if instrument is not None:
        free = _weighted(instrument, weight) / size
        left, right = free.T @ left, free.T @ right
    found = np.linalg.lstsq(left, right, rcond=1e-12)[0] / size
    pairs = len(PAIRS[rows.motion.shape[1]])
    return found[:pairs], found[pairs:-1], float(found[-1])


def _weighted(columns: np.ndarray, weight: np.ndarray) -> np.ndarray:
    return _real((weight @ columns).reshape(-1, columns.shape[-1]))


def _real(values: np.ndarray) -> np.ndarray:
    """Real above imaginary parts."""
    return np.concatenate([values.real, values.imag])


def _matrix(entries: np.ndarray) -> np.ndarray:
    if len(entries) == 1:
        return np.asarray(entries)[None]
    return np.array([[entries[0], entries[2]], [entries[2], entries[1]]])
