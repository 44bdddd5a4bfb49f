"""What terms of the instrument promise beside a fit, from what it predicts and its Jacobian: no program is compiled.

At strength zero a term moves a reading as the gain, the phase, the row before, or the frequency of the device do, and
all of these are known where a fit ended. So the instrument and the device are compared on the same residual before
either is refitted.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import linalg, optimize, special

from memsgyro_jax.effects import InstrumentTerm, free_numbers
from memsgyro_jax.effects.instrument import SeenRows
from memsgyro_jax.measurement.experiments import Readings
from memsgyro_jax.measurement.model import Model

from .fit import CaseFit
from .optimum import Optimum
from .score import basis
from .search import Ranking, Search


MOST_TERMS = 4  # that are promised together
FARTHER = 3.0  # times a bound: what would have to go so far is no answer
CLOSE = 0.7  # of what the first gains: a rival that is fitted beside it


@dataclass(frozen=True, eq=False)
class Offer:
    """Something that may move a residual: its sensitivities (r, k), bounds and prior standard deviations (k,)."""

    slopes: np.ndarray
    low: np.ndarray
    high: np.ndarray
    prior: np.ndarray


@dataclass(frozen=True)
class Promise:
    """What some offers together would take from χ², the best first.

    Args:
        chosen: positions of the offers.
        gain: by how much χ² and what is known beforehand fall, to the first order.
        worth: the same less what each number must gain, by the Bayesian information criterion.
        alone: the gain of each of all offers alone.
    """

    chosen: tuple[int, ...]
    gain: float
    worth: float
    alone: tuple[float, ...]

    @property
    def worth_a_fit(self) -> tuple[int, ...]:
        """Those chosen, and rivals that alone would gain nearly as much as the first."""
        rivals = [i for i, gain in enumerate(self.alone) if self.chosen and gain >= CLOSE * self.alone[self.chosen[0]]]
        return tuple(dict.fromkeys([*self.chosen, *rivals]))


def promised(optimum: Optimum, offers: Sequence[Offer], level: float) -> Promise:
    """The offers that together explain most of what a fit leaves, added one by one while each helps beyond chance, at
    a probability `level` of any; what they leave counts as noise if it is more.
    """
    q, residual = basis(optimum.jacobian), optimum.residual
    every = np.concatenate([offer.slopes for offer in offers], axis=1)
    clean = every - q @ (q.T @ every)
    clean = clean - q @ (q.T @ clean)
    root = np.linalg.qr(np.column_stack([clean, residual - q @ (q.T @ residual)]), mode="r")
    ends = np.cumsum([offer.slopes.shape[1] for offer in offers])
    columns = [np.arange(end - offer.slopes.shape[1], end) for end, offer in zip(ends, offers, strict=True)]
    news = np.linalg.norm(clean, axis=0) > 1e-6 * np.maximum(np.linalg.norm(every, axis=0), 1e-300)

    def gain(chosen: Sequence[int]) -> float:
        held = [columns[i][news[columns[i]]] for i in chosen]
        bounds = [np.stack([o.low, o.high, o.prior], axis=1)[news[columns[i]]] for i in chosen for o in [offers[i]]]
        return _gain(root, np.concatenate(held), np.concatenate(bounds))

    count = [int(news[mine].sum()) for mine in columns]
    price, dof = np.log(residual.size), optimum.dof
    alone = tuple(gain([i]) for i in range(len(offers)))
    chosen: list[int] = []
    total = 0.0
    while len(chosen) < MOST_TERMS:
        more = {i: gain([*chosen, i]) - total for i in range(len(offers)) if i not in chosen and count[i]}
        best = max(more, key=lambda i: more[i] - price * count[i], default=None)
        if best is None:
            break
        scale = max(1.0, (optimum.chi2 - total - more[best]) / dof)
        if special.chdtrc(count[best], more[best] / scale) * len(offers) > level:
            break
        chosen.append(best)
        total += more[best]
    return Promise(tuple(chosen), total, total - price * sum(count[i] for i in chosen), alone)


def promised_by_effects(search: Search, ranking: Ranking) -> Promise | None:
    """What further effects of the device promise; `None` where there is none."""
    low, high = search.joint.bounds
    blocks = [search.joint.of_effect(i) for i in ranking.places]
    offers = [Offer(s, low[b], high[b], np.full(b.size, np.inf)) for s, b in zip(ranking.slopes, blocks, strict=True)]
    return promised(search.optimum, offers, search.level) if offers else None


def _gain(root: np.ndarray, places: np.ndarray, bounds: np.ndarray) -> float:
    """By how much a bounded step along some columns lowers the squared length of the last."""
    if places.size == 0:
        return 0.0
    low, high, prior = bounds.T
    matrix, target = root[:, places], -root[:, -1]
    size = np.linalg.norm(matrix, axis=0)
    known = np.diag(1.0 / prior)  # nothing where a prior is infinite
    whole = np.concatenate([matrix, known]) / size
    wanted = np.concatenate([target, np.zeros(places.size)])
    step = np.linalg.lstsq(whole, wanted)[0]
    if np.any((step > FARTHER * high * size) | ((low < 0) & (step < FARTHER * low * size))):
        return 0.0  # a fit would end at the bound, and be refused
    if np.any((step < low * size) | (step > high * size)):
        step = optimize.lsq_linear(whole, wanted, (low * size - 1e-300, high * size + 1e-300)).x
    return max(0.0, float(target @ target - np.sum((whole @ step - wanted) ** 2)))


def offers_of(fit: CaseFit, terms: Sequence[InstrumentTerm]) -> list[Offer]:
    """What terms of the instrument, none of which is in the model, would move of the fitted readings."""
    blocks: list[list[np.ndarray]] = [[] for _ in terms]
    ends = np.cumsum([r.size for r in fit.joint.fitted])
    for readings, end in zip(fit.joint.fitted, ends, strict=True):
        seen, spread = _seen(fit, readings, slice(end - readings.size, end))
        for block, term in zip(blocks, terms, strict=True):
            block.append(_whitened(term, seen, spread) if seen else np.zeros((readings.size, term.strength.size)))
    out = []
    for term, block in zip(terms, blocks, strict=True):
        (number,) = [n for n in free_numbers(term) if n.field == "strength"]
        every = np.ones(term.strength.size)
        known = np.inf * every if term.known_to is None else term.known_to
        out.append(Offer(np.concatenate(block), number.low * every, number.high * every, known))
    return out


def _whitened(term: InstrumentTerm, seen: SeenRows, spread: np.ndarray) -> np.ndarray:
    moved = -term.slopes(seen) / spread[..., None]
    parts = [moved.real, moved.imag] if np.iscomplexobj(seen.values) else [moved.real]
    return np.stack(parts, axis=2).reshape(-1, term.strength.size)


def _seen(fit: CaseFit, readings: Readings, span: slice) -> tuple[SeenRows, np.ndarray] | tuple[None, None]:
    """What the fit predicts of some readings and how that moves, and their noise; `None` for what was known before."""
    experiment, joint, optimum = readings.experiment, fit.joint, fit.optimum
    around, std = getattr(experiment, "surroundings", None), getattr(experiment.noise, "std", None)
    if around is None or std is None:
        return None, None
    measured = np.asarray(experiment.measured)
    rows, spread = (len(measured),), np.broadcast_to(np.asarray(std), measured.shape)

    def volts(white: np.ndarray) -> np.ndarray:
        """The change of the prediction that a change of the residual stands for."""
        if np.iscomplexobj(measured):
            white = white.reshape(*measured.shape, 2) @ [1.0, 1j]
        return -white.reshape(measured.shape) * np.where(np.isfinite(spread), spread, 0.0)

    def along(letter: str) -> np.ndarray:
        free = [joint.parameters[i] for i in optimum.free]
        mine = np.array([p.effect is None and p.name.startswith(letter) for p in free])
        return volts(optimum.jacobian[span][:, mine] @ optimum.vector[optimum.free[mine]])

    def row(name: str) -> np.ndarray:
        """A condition of each row; a capture has more of them before the first reading."""
        return np.broadcast_to(np.ravel(getattr(around, name))[-len(measured) :], rows)

    values = measured + volts(optimum.residual[span])
    before = values if getattr(experiment, "before", None) is None else _before(fit, readings, values)
    ringing, turning = _ringing(fit.model, experiment, values, before)
    own = np.asarray(getattr(experiment, "time", 0.0))
    force = np.sum(np.real(np.asarray(getattr(experiment, "force", 0.0))), axis=-1)
    return SeenRows(
        values=values,
        by_frequency=2.0 * along("k"),
        by_damping=along("d"),
        force=np.broadcast_to(force, rows),
        frequency=np.broadcast_to(np.asarray(getattr(experiment, "frequency", 0.0)), rows),
        record=row("record"),
        sweep=row("sweep"),
        time=own if own.shape == rows else row("time"),
        ringing=ringing,
        turning=turning,
        before=before,
    ), spread


def _before(fit: CaseFit, readings: Readings, values: np.ndarray) -> np.ndarray:
    """What the fit predicts of the row before each: the readings there would follow any misfit that is smooth."""
    out = values.copy()
    for number in np.unique(readings.record[readings.record >= 0]):
        mine = readings.record == number
        predicted = fit.predicted(int(number))[np.maximum(readings.row[mine] - 1, 0)]
        out[mine] = np.where(np.isfinite(predicted), predicted, values[mine])
    return out


def _ringing(model: Model, experiment: Any, values: np.ndarray, before: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """What is left of the motion of the row before, and how fast it turns; zero where no clock says, or no row follows
    another.
    """
    still = np.zeros_like(values)
    dwell = getattr(experiment, "dwell", None)
    if dwell is None:
        return still, still
    dwell = np.asarray(dwell)
    device = model.device
    one, omega = np.eye(values.shape[1]), np.asarray(experiment.frequency)[:, None, None]
    damping = np.asarray(device.damping_matrix)
    push = np.asarray(device.stiffness_matrix) - omega**2 * one + 1j * omega * damping
    decay = np.linalg.solve(2j * omega * one + damping, push)
    known = np.isfinite(dwell)
    left = linalg.expm(-decay * np.where(known, dwell, 0.0)[:, None, None]) * known[:, None, None]
    apart = left * (0.0 if experiment.unsettled is None else np.asarray(experiment.unsettled)[:, None, None])
    ringing = left @ np.linalg.solve(one - apart, (before - values)[..., None])
    return ringing[..., 0], (decay @ ringing)[..., 0]
