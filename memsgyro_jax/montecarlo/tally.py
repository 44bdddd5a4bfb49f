"""Figures of a lot gathered part by part, so that no column of a large one is ever in memory."""

from collections.abc import Mapping

import numpy as np
from jaxtyping import Float, Int

from .batch import Plan
from .caveats import NAMED, Movement, Order, Scatter
from .merit import Moments
from .sketch import EXACT, Sketch
from .status import DIVERGED, LOST, OK, STATUS


_HELD = 0.05  # of a run: for how long at its end a die must be within the tolerance to have converged
FOLLOWED = 8192  # dies whose rate and estimate over time are kept, where the rate varies


class Tally:
    """What the summary of a lot is made of, from parts of it in the order of their dies.

    Sums, counts and root mean squares are exact, quantiles as a `Sketch` has them. Of the first `bounded` dies the
    error at the end is kept, to be compared with their bounds; of diverged ones all numbers and the first `EXACT`
    coefficients; of the first `FOLLOWED` ones the rate over time, where it varies. Dies whose modes stand in another
    `order` are counted.
    """

    def __init__(self, plan: Plan, bounded: int, order: Order | None = None):
        self.movement, self.order, self.crossed, self.first_crossed = Movement(plan), order, 0, list[int]()
        self.scatter, self.plan, self.settled = Scatter(plan), plan, plan.window_times >= plan.settle
        self.computed = self.lost = self.redrawn = self.good = 0
        self.end, self.sound, self.run, self.nees, self.converged, self._lost_at = (Sketch() for _ in range(6))
        self.series_squares = 0.0
        self.series_count = 0
        self.sums = dict.fromkeys(("nees_end", "nis_mean", "claim"), (0, 0.0))
        self.straight = Moments(2)
        self.first = np.full((2, bounded), np.nan)  # errors at the end: all, and those of sound dies
        self._diverged: list[np.ndarray] = []
        self._theta: list[np.ndarray] = []
        self._followed: list[tuple[np.ndarray, np.ndarray]] = []

    def add(self, rows: Mapping[str, np.ndarray], first: int) -> None:
        """Take in the dies from `first` on; those that are pending are left out."""
        status, end = rows[STATUS], rows["rate_error_end"]
        sound, lost, astray = status == OK, status == LOST, status == DIVERGED
        alive = sound | astray
        self.computed += int(np.sum(alive | lost))
        self.lost += int(np.sum(lost))
        self._lost_at.add(rows["lost_at"][lost])
        self.redrawn += int(np.sum(rows["redrawn"][alive | lost] > 0))
        self.good += int(np.sum(np.abs(end[alive]) <= self.plan.tolerance))
        self.end.add(_finite(end[alive]))
        self.sound.add(_finite(end[sound]))
        self.run.add(_finite(rows["rate_error_rms"][alive]))
        series = _finite(rows["rate_series_std"][alive])
        self.series_squares, self.series_count = (
            self.series_squares + float(np.sum(series**2)),
            self.series_count + series.size,
        )
        self.nees.add(rows["nees_end"][alive])
        late = rows["convergence_time"][alive]
        # Within the tolerance for the last samples alone is by chance: their time is that of the run's end.
        held = late <= (1.0 - _HELD) * self.plan.samples * self.plan.period
        self.converged.add(np.where(held, late, np.inf))
        with np.errstate(divide="ignore", invalid="ignore"):
            judged = {**rows, "claim": (end / rows["rate_std_end"]) ** 2}
        for name, (count, total) in self.sums.items():
            finite = _finite(judged[name][alive])
            self.sums[name] = count + finite.size, total + float(np.sum(finite))
        if (few := min(len(status), self.first.shape[1] - first)) > 0:
            self.first[:, first : first + few] = np.where(alive, end, np.nan)[:few], np.where(sound, end, np.nan)[:few]
        if self.order is not None:
            places = np.flatnonzero(self.order.crossed(rows["coefficient_true"]) & (alive | lost))
            self.crossed += len(places)
            self.first_crossed += (first + places[: NAMED - len(self.first_crossed)]).tolist()
        self._diverge(rows, first, np.flatnonzero(astray))
        self._over_time(rows, alive)

    @property
    def diverged(self) -> tuple[Int[np.ndarray, " dies"], Float[np.ndarray, "first coefficients"]]:
        """Numbers of the diverged dies, and the coefficients of the first of them."""
        return np.concatenate([*self._diverged, np.empty(0, int)]), np.concatenate(self._theta or [np.empty((0, 0))])

    @property
    def lost_at(self) -> tuple[float, float, float] | None:
        """When the first die was lost, the median one and the last [s]; None without any."""
        first, middle, last = self._lost_at.quantile(0.0, 0.5, 1.0)
        return (first, middle, last) if self.lost else None

    @property
    def over_time(self) -> tuple[np.ndarray, np.ndarray] | None:
        """Rate and estimate of the first dies; None where no rate varies."""
        rates, estimates = zip(*self._followed, strict=True) if self._followed else ((), ())
        return (np.concatenate(rates), np.concatenate(estimates)) if rates else None

    @property
    def crossing(self) -> str | None:
        """What is to be said of the dies whose modes have changed places; None without any."""
        if self.order is None or not self.crossed:
            return None
        return self.order.sentence(self.first_crossed, self.crossed, self.computed)

    def mean(self, name: str) -> float | None:
        """Of NEES, NIS or the squared error of the rate over what is claimed of it, over the dies that have one."""
        count, total = self.sums[name]
        return total / count if count else None

    def _diverge(self, rows: Mapping[str, np.ndarray], first: int, places: Int[np.ndarray, " diverged"]) -> None:
        if places.size:
            self._diverged.append(first + places)
            room = EXACT - sum(map(len, self._theta))
            self._theta.append(rows["coefficient_true"][places[: max(room, 0)]])

    def _over_time(self, rows: Mapping[str, np.ndarray], alive: np.ndarray) -> None:
        true, estimate = rows["rate_true"][alive], rows["rate_estimate"][alive]
        if not alive.any():
            return
        self.movement.add(true, estimate)
        self.scatter.add(true, estimate)
        mean = np.mean(true[:, self.settled], axis=1)
        self.straight.add(np.stack([mean, np.mean(estimate[:, self.settled], axis=1) - mean], axis=1))
        room = FOLLOWED - sum(len(rates) for rates, _ in self._followed)
        if room > 0 and np.ptp(true[:, self.settled], axis=1).any():
            self._followed.append((true[:room].copy(), estimate[:room].copy()))


def _finite(values: np.ndarray) -> np.ndarray:
    return values[np.isfinite(values)]
