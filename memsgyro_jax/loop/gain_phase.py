"""Gain and phase margins of the loops of classic control, in decibels and degrees."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Complex, Float

from memsgyro_jax.base import runtime
from memsgyro_jax.base.arguments import refuse_traced
from memsgyro_jax.base.display import Shown
from memsgyro_jax.base.files import finite
from memsgyro_jax.base.text import aligned

from .lateness import uncounted, uncounted_effects
from .loop import ClosedLoop
from .stability import Lock, LoopMargins, at_lock, loop_margins


HEAD = ("loop", "distance from -1", "crossover", "phase margin", "gain margin up", "and down")
TOGETHER = "rate and quadrature together"
_MORE = (
    "Margins with > are where the loop reaches a tenth of the drive's frequency: beyond, averaging and samples count, "
    "which are left out here; simulate the loop with its gain raised for more."
)
_NOT_HELD = "Its margins are averaged over the drive's periods and do not hold there: simulate the loop."
_HALVINGS = 40
_HOLDS = 0.1  # of the drive's frequency, up to which loops that are averaged over its periods behave so
_BEYOND = np.geomspace(_HOLDS, 10.0, 401)  # of it, where they may not
_CHANGES = np.arange(0.5, 80.1, 0.5)  # dB, of a gain that two loops share


@dataclass(frozen=True, eq=False, repr=False)
class GainPhaseMargins(Shown):
    """Margins of one die's four loops in the order of `LoopMargins`, each opened where its output acts while the others
    are closed, and last of rate and quadrature `TOGETHER`, which share the gains of read-out and electrode of y.

    `crossover` [Hz] is where the loop's gain is 1 with the least `phase_margin` [degrees]; `increase` and `decrease`
    [dB] are by how much its gain may grow, and fall, until it oscillates; `decrease` is infinite where no fall does
    that. The model is averaged over the drive's periods and knows no samples: it holds while `increase` is below
    `known_to` [dB], at which the loop reaches a tenth of the drive's frequency, and `increase` is infinite where the
    loop bears that much; how much more, simulations tell. NaN where the loop hands nothing back, where it is unstable
    as it is, for a crossover that it has not, and for that of two loops. `distance` are the least distances of the
    Nyquist curves from -1, of rate and quadrature the one of both. `left_out` are the device's effects that the margins
    do not count.
    """

    distance: LoopMargins
    crossover: Float[np.ndarray, " 5"]
    phase_margin: Float[np.ndarray, " 5"]
    increase: Float[np.ndarray, " 5"]
    decrease: Float[np.ndarray, " 5"]
    known_to: Float[np.ndarray, " 5"]
    left_out: tuple[str, ...] = ()

    @property
    def notes(self) -> tuple[str, ...]:
        """Sentences on how far the margins are known, on loops that are beyond that, and on effects not counted."""
        found = list(uncounted(self.left_out))
        if fast := [name for name, most in zip(self._distances, self.known_to, strict=True) if most <= 0.0]:
            found.insert(0, f"Reaches beyond a tenth of the drive's frequency as it is: {', '.join(fast)}. {_NOT_HELD}")
        elif np.any(np.isinf(self.increase)):
            found.insert(0, _MORE)
        return tuple(found)

    @property
    def _distances(self) -> dict[str, float]:
        return {
            **{name: float(each) for name, each in self.distance._asdict().items()},
            TOGETHER: float(self.distance.rate),
        }

    def rows(self) -> list[tuple[str, ...]]:
        """Of each loop its name and the figures as text, in the order of `HEAD`."""
        rows = []
        for k, (name, distance) in enumerate(self._distances.items()):
            cells = (self.crossover[k], self.phase_margin[k], self.increase[k], self.decrease[k])
            shown = [_with_unit(value, unit) for value, unit in zip(cells, (" Hz", "°", " dB", " dB"), strict=True)]
            if np.isinf(self.increase[k]):
                shown[2] = f"> {self.known_to[k]:.3g} dB" if self.known_to[k] > 0.0 else "unknown"
            rows.append((name, f"{distance:.3g}", *shown))
        return rows

    def __str__(self) -> str:
        return "\n".join([aligned([HEAD, *self.rows()]), *(f"  {note}" for note in self.notes)])

    def as_dict(self) -> dict[str, dict[str, float]]:
        """Entries for JSON by loop; null where there is no number. A `gain_margin_up_db` of null beside a number of
        `gain_margin_up_above_db` is more than this.
        """
        names = (
            "crossover_hz",
            "phase_margin_deg",
            "gain_margin_up_db",
            "gain_margin_up_above_db",
            "gain_margin_down_db",
        )
        above = np.where(np.isinf(self.increase) & (self.known_to > 0.0), self.known_to, np.nan)
        columns = (self.crossover, self.phase_margin, self.increase, above, self.decrease)
        return finite({
            name: {"distance": distance, **{n: float(c[k]) for n, c in zip(names, columns, strict=True)}}
            for k, (name, distance) in enumerate(self._distances.items())
        })  # fmt: skip


def gain_phase_margins(loop: ClosedLoop) -> GainPhaseMargins:
    """Gain and phase margins of the loops of a die in classic control, of the linearised loops of `loop_margins`.

    Crossings are looked for between 0.0016 Hz and the drive's frequency, what oscillates up to a tenth of it: beyond,
    averaging and samples (ten in a period, say) count, which simulations of the loop with a larger gain show. Below,
    samples are little: holding a force takes 180°·crossover/sample rate, a demodulator in samples gives as much or more
    back. Of a loop that crosses at a twentieth of the drive's frequency simulations have 2° more phase margin at 8
    samples in a period than at 100 and 0.4° at 27 (a tracking demodulator; a product one 0.6° and 0.1° less), where
    averaging leaves out 5° (1°). Of the device's effects a `ReadoutDelay` is counted. Raises `InputError` for another
    controller, for a lot, and for numbers that a transformation of JAX traces: `loop_margins` has gradients.
    """
    runtime.require_float64("`gain_phase_margins`")
    refuse_traced("`gain_phase_margins` looks for crossings and", "plain numbers, or take `loop_margins`", loop)
    distance, lock = loop_margins(loop), at_lock(loop)
    curve, span = _open_loops(lock), np.geomspace(1e-2, lock.omega, 6001)  # rad/s
    along = curve(span)
    found = [_of_loop(lambda w, k=k: curve(w)[:, k], span, along[:, k], float(distance[k])) for k in range(4)]
    figures = np.array([*found, _of_both(lock, found[2:])]).T
    known_to = np.array([_known_to(lock, own) for own in ([0], [1], [2], [3], [2, 3])])
    known_to[np.isnan(figures[2])] = np.nan
    figures[2, figures[2] > known_to] = np.inf
    return GainPhaseMargins(distance, *figures, known_to=known_to, left_out=uncounted_effects(loop))


def _open_loops(lock: Lock) -> Callable[[Float[np.ndarray, " some"]], Complex[np.ndarray, "some 4"]]:
    """What each of the four loops, opened where its output acts while the others are closed, hands back with the sign
    turned, at angular frequencies [rad/s].
    """
    closed, push, out = lock[:3]

    def handed_back(omega: Float[np.ndarray, " some"]) -> Complex[np.ndarray, "some 4"]:
        moved = np.linalg.solve(1j * omega[:, None, None] * np.eye(len(closed)) - closed, push + 0j)
        return 1.0 / (1.0 + np.diagonal(out @ moved, axis1=1, axis2=2)) - 1.0

    return handed_back


def _poles_with(lock: Lock) -> Callable[[float], Complex[np.ndarray, " states"]]:
    """`closed_poles` where the loops of rate and quadrature are both so many times as strong."""
    closed, push, out = lock[:3]
    return lambda times: np.linalg.eigvals(closed + (times - 1.0) * push[:, 2:] @ out[2:])


def _known_to(lock: Lock, own: list[int]) -> float:
    """Increase [dB] of the gains of the loops `own`, opened together, at which one reaches where the model ends."""
    opened = lock.closed - lock.push[:, own] @ lock.out[own]
    poles = np.linalg.eigvals(opened)
    beside = np.abs(poles.imag[:, None] + poles.real[:, None] * np.array([-1.0, 0.0, 1.0])).ravel()
    omega = np.concatenate([lock.omega * _BEYOND, beside[beside > _HOLDS * lock.omega]])
    moved = np.linalg.solve(1j * omega[:, None, None] * np.eye(len(opened)) - opened, lock.push[:, own] + 0j)
    most = np.max(np.linalg.norm(lock.out[own] @ moved, ord=2, axis=(1, 2)))
    return float(-20.0 * np.log10(max(most, 1e-300)))


def _of_loop(
    curve: Callable, span: np.ndarray, along: np.ndarray, distance: float
) -> tuple[float, float, float, float]:
    """Crossover, phase margin, increase and decrease of a loop, whose curve is `along` at the frequencies `span`."""
    if distance < 0.0 or np.max(np.abs(along)) < 1e-9:
        return (np.nan,) * 4
    unity = _crossings(lambda w: np.log(np.abs(curve(w))), span, np.log(np.abs(along)))
    left = 180.0 - np.abs(np.degrees(np.angle(curve(unity))))
    crossover, phase = (unity[np.argmin(left)] / (2.0 * np.pi), np.min(left)) if len(unity) else (np.nan, np.nan)
    turned = curve(_crossings(lambda w: curve(w).imag, span, along.imag))
    gains = -20.0 * np.log10(np.abs(turned[turned.real < 0.0]))
    return crossover, phase, np.min(gains[gains > 0.0], initial=np.inf), np.max(gains[gains < 0.0], initial=-np.inf)


def _of_both(lock: Lock, alone: list[tuple[float, ...]]) -> tuple[float, float, float, float]:
    """As `_of_loop` of rate and quadrature when both gains change by the same factor."""
    if np.isnan(alone).all():
        return (np.nan,) * 4
    poles = _poles_with(lock)
    rest = 1e-9 * np.max(np.abs(poles(1.0)))  # an integral's pole at zero, but for rounding

    def oscillates(change: float) -> bool:
        return bool(np.max(poles(10.0 ** (change / 20.0)).real) > rest)

    def first(changes: np.ndarray) -> float:
        far = next((k for k, change in enumerate(changes) if oscillates(change)), None)
        if far is None:
            return np.copysign(np.inf, changes[-1])
        near, beyond = changes[far - 1] if far else 0.0, changes[far]
        for _ in range(_HALVINGS):
            middle = 0.5 * (near + beyond)
            near, beyond = (near, middle) if oscillates(middle) else (middle, beyond)
        return float(beyond)

    return np.nan, np.nan, first(_CHANGES), first(-_CHANGES)


def _crossings(height: Callable, span: np.ndarray, along: np.ndarray) -> np.ndarray:
    """Angular frequencies at which `height`, which is `along` at those of `span`, changes its sign."""
    places = np.flatnonzero(np.sign(along[1:]) != np.sign(along[:-1]))
    low, high, sign = span[places], span[places + 1], np.sign(along[places])
    for _ in range(_HALVINGS if len(places) else 0):
        middle = np.sqrt(low * high)
        same = np.sign(height(middle)) == sign
        low, high = np.where(same, middle, low), np.where(same, high, middle)
    return low


def _with_unit(value: float, unit: str) -> str:
    return "–" if np.isnan(value) else "any" if np.isinf(value) else f"{value:.3g}{unit}"
