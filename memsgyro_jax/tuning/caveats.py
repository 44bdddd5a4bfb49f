"""What a user must know before believing a gain: claims that do not hold, lost dies, a loop near oscillation."""

from collections.abc import Sequence

import numpy as np
from scipy import stats

from memsgyro_jax.base.concrete import is_concrete
from memsgyro_jax.loop.controllers import ClassicControl
from memsgyro_jax.loop.lateness import uncounted, uncounted_effects
from memsgyro_jax.loop.loop import ClosedLoop
from memsgyro_jax.loop.stability import loop_margins

from .result import Interval, Merit, TunedNumber
from .right import CONSISTENT, EACH, LEVEL


ABSORBING = (
    "the gains are absorbing an error of the model; find what is missing first (`memsgyro compare`, "
    "`memsgyro diagnose`), add it or its process noise, and tune again."
)
_NEAR = 0.5  # distance of a Nyquist curve from -1: 6 dB of gain and 29 degrees of phase at least
_EATEN = 0.9  # of the distance before: what is left of it where tuning has eaten some


def warnings_of(after: Merit, lost_before: int, ratio: Interval) -> tuple[str, ...]:
    """What a user must know before believing the gain; of right loops that are no worse than before a share of `LEVEL`
    is warned of. `ratio` of the errors has an interval that a share of half of that exceeds.
    """
    found = []
    if after.consistent is False:
        when = "the error falls while" if ratio.high < 1.0 else "after tuning"
        why = (
            "the filter claims more error than it makes; a read-out noise that it is told too large and that is not "
            "free (`observer.noise_density`), a prior wider than the dies vary, an annealing that has not ended, or "
            "noises raised for an error of the model do that."
            if after.cautious
            else ABSORBING
        )
        found.append(f"{when} {after.inconsistency}: {why}")
    if after.lost:
        found.append(f"{after.lost} of {after.dies} unseen dies are lost with the tuned loop ({lost_before} before).")
    if ratio.low > 1.0:
        found.append(
            f"the mean squared error on unseen dies has risen to {ratio} of that before, by an interval of "
            f"{100.0 * (1.0 - 0.5 * LEVEL):g} %; the start was better."
        )
    return tuple(found)


def of_record(nis: tuple[float, float], readings: int, numbers: Sequence[TunedNumber]) -> tuple[str, ...]:
    """A sentence where the mean `nis` of so many held-out readings of both channels is another than that of a right
    filter, but for one right case in 400 of a channel; it names the numbers that end at a bound.
    """
    half = float(stats.norm.isf(0.5 * EACH)) * np.sqrt(2.0 / readings)
    low, high = min(CONSISTENT[0], 1.0 - half), max(CONSISTENT[1], 1.0 + half)
    if all(low <= value <= high for value in nis):
        return ()
    bound = [f"`{n.label}` {part}" for n in numbers for part in n.fate.split(", ") if part.endswith("bound")]
    ends = f" ({'; '.join(bound)})" if bound else ""
    why = (
        "the filter claims more error than it makes; a noise that it is told too large and that is not free does that."
        if all(value <= high for value in nis)
        else ABSORBING
    )
    said = f"after tuning NIS of what was held out is {nis[0]:.3g}, {nis[1]:.3g} instead of 1 ({low:.3g} to {high:.3g})"
    return (f"{said}{ends}: {why}",)


def margin_eaten(before: ClosedLoop, after: ClosedLoop) -> tuple[str, ...]:
    """A sentence where tuning has brought a loop of classic control nearer to oscillation than is usual."""
    if not isinstance(after.controller, ClassicControl) or not is_concrete(before, after):
        return ()
    had, has = (
        {name: float(np.min(one)) for name, one in loop_margins(loop)._asdict().items()} for loop in (before, after)
    )
    worst = min(has, key=has.__getitem__)
    if has[worst] >= _NEAR or has[worst] > _EATEN * had[worst]:
        return ()
    said = (
        f"the {worst} loop comes as near as {has[worst]:.2g} to -1 ({had[worst]:.2g} before; {_NEAR:g} leaves 6 dB): a "
        "rate error does not feel how near a loop is to oscillating; `loss=mg.losses.Weighted((mg.losses."
        "SquaredRateError(settle), 1.0), (mg.losses.LoopMargin(), 10.0))` does, `mg.gain_phase_margins` tells more."
    )
    return (" ".join([said, *uncounted(uncounted_effects(after))]),)
