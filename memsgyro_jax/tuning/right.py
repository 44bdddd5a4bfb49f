"""What the claims of a right filter look like over the dies of a lot, so that warnings come at a stated level."""

import numpy as np
from scipy import stats

from memsgyro_jax.loop.loop import ClosedLoop
from memsgyro_jax.loop.observers import AbstractCovarianceObserver
from memsgyro_jax.montecarlo.sweep import Lot


LEVEL = 0.01  # share of right loops that are warned of; divided among what is looked at: two NIS, NEES and the error
EACH = LEVEL / 4.0
CONSISTENT = (0.9, 1.1)  # mean of e²/S of a channel within which a filter's claims pass as right


def nis_interval(dies: int, innovations: int) -> tuple[float, float]:
    """Where the mean of e²/S of a channel over so many `innovations` of each of `dies` lies for a right filter, but for
    one case in 400: that of χ², `CONSISTENT` at the least, as nobody minds less.

    Not from how the dies differ: those of a wrong filter do by as much as it is wrong, and an interval that widens with
    them calls it right.
    """
    count = dies * innovations
    if count == 0:
        return CONSISTENT
    low, high = (float(end) / count for end in stats.chi2.interval(1.0 - EACH, count))
    return min(CONSISTENT[0], low), max(CONSISTENT[1], high)


def nees_interval(
    dies: int, states: int, expected: float, slack: tuple[float, float] = (0.0, 0.0)
) -> tuple[float, float]:
    """Where the mean NEES of a right filter over so many dies lies but for one case in 400: that of χ² about what is
    `expected`, wider by the `slack` (below and above) of what it may be expected to be.
    """
    count = max(dies, 1)
    ends = stats.chi2.interval(1.0 - EACH, states * count)
    low, high = (expected + float(end) / count - states + more for end, more in zip(ends, slack, strict=True))
    return low, high


def shift_of_nees(lot: Lot, loop: ClosedLoop) -> tuple[float, tuple[float, float]]:
    """By how much a right filter's mean NEES differs from the number of states because the dies turn at another rate
    than the prior expects, and between which limits that may be more or less.

    A coefficient that lies d standard deviations of the prior from its mean adds (d² - 1) P/P₀, for a linear filter
    with variance P at the end and P₀ in the prior. P is known of the rate; of a device's other rate (`rate_x`), which
    nobody may have learnt anything of, it lies between zero and P₀.
    """
    observer = loop.observer
    assert isinstance(observer, AbstractCovarianceObserver)  # no other observer gives a NEES
    place, rates = observer.model.index("rate"), [c.name for c in observer.model.coefficients if c.is_rate]
    mean, std = (float(numbers[place]) for numbers in (observer.prior.theta, observer.prior.theta_std))
    turning = lot.data["rate_true"].values
    moves = bool(np.nanmax(np.ptp(turning, axis=1)) > 1e-9 * (np.nanmax(np.abs(turning)) + 1e-9))  # the prior is past
    if moves or "rate" not in observer.states or not std > 0.0:
        return 0.0, (0.0, 0.0)
    off = float(np.nanmean((turning[:, -1] - mean) ** 2)) / std**2 - 1.0
    left = float(np.nanmean(lot.data["rate_std_end"].values ** 2)) / std**2
    others = sum(name in observer.states for name in rates) - 1
    return off * left, (others * min(off, 0.0), others * max(off, 0.0))
