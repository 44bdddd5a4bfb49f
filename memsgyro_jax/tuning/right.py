"""What the claims of a right filter look like over the dies of a lot, so that warnings come at a stated level."""

import numpy as np
from jaxtyping import Float
from scipy import stats

from memsgyro_jax.loop.loop import ClosedLoop
from memsgyro_jax.loop.observers import AbstractCovarianceObserver
from memsgyro_jax.montecarlo.sweep import Lot


LEVEL = 0.01  # share of right loops that are warned of; divided among what is looked at: two NIS, NEES and the error
EACH = LEVEL / 4.0
CONSISTENT = (0.9, 1.1)  # mean of e²/S of a channel within which a filter's claims pass as right


def nis_interval(channel: Float[np.ndarray, " dies"]) -> tuple[float, float]:
    """Where the mean of e²/S of a right filter lies but for one case in 400, from how the dies differ; `CONSISTENT`
    at the least, as nobody minds less.
    """
    channel = channel[np.isfinite(channel)]
    if len(channel) < 2:
        return CONSISTENT
    half = float(stats.t.isf(0.5 * EACH, len(channel) - 1) * np.std(channel, ddof=1) / np.sqrt(len(channel)))
    return min(CONSISTENT[0], 1.0 - half), max(CONSISTENT[1], 1.0 + half)


def nees_interval(
    nees: Float[np.ndarray, " dies"], states: int, expected: float, slack: tuple[float, float] = (0.0, 0.0)
) -> tuple[float, float]:
    """Where the mean NEES of a right filter lies but for one case in 400: that of χ² about what is `expected`, wider
    where the dies differ by more, and by the `slack` (below and above) of what it may be expected to be.
    """
    count = max(len(nees), 1)
    wider = max(1.0, float(np.std(nees)) / np.sqrt(2.0 * states)) if len(nees) > 1 else 1.0
    ends = stats.chi2.interval(1.0 - EACH, states * count)
    low, high = (expected + wider * (float(end) / count - states) + more for end, more in zip(ends, slack, strict=True))
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
