"""What makes a log of rates more or less than noise at rest: steps as coarse as it, and knocks."""

import numpy as np

from .rate_log import RateLog


_COARSE = 1.0  # of the noise from row to row: of larger steps rounding is more than a tenth of what is measured
_KNOCK = 6.5  # times what is usual from row to row: noise does so once in 10¹⁰
_ALIKE = 1e-9  # of the largest rate: what the reading of decimals adds


def doubts_of(log: RateLog) -> tuple[str, ...]:
    """A sentence for each series whose rates come in steps as large as their noise, or jump now and then."""
    return tuple(
        said for name, rate in zip(log.names, log.rate, strict=True) for said in _doubts(name, rate, log.period)
    )


def _doubts(name: str, rate: np.ndarray, period: float) -> list[str]:
    moves = np.abs(np.diff(rate))
    step = _step_of(rate)
    usual = max(1.4826 * float(np.median(moves)), step)
    knocks = np.flatnonzero(moves > _KNOCK * usual)
    noise = float(np.sqrt(np.mean(np.delete(moves, knocks) ** 2) / 2.0))
    said = []
    if step > _COARSE * noise:
        said.append(
            f"`{name}` comes in steps of {np.degrees(step):.3g} deg/s, coarser than its noise from row to row, "
            f"{np.degrees(noise):.3g} deg/s: rounding adds to its terms, and hides some of what the sensor itself does."
        )
    if knocks.size and usual > 0.0:
        said.append(
            f"{knocks.size} of {moves.size} steps of `{name}` from row to row are more than {_KNOCK:g} times as large "
            f"as is usual, the first at {(knocks[0] + 1) * period:.3g} s: it jumps, as by knocks, turns or lost bits, "
            "which count as noise here."
        )
    return said


def _step_of(rate: np.ndarray) -> float:
    """The smallest difference of two rates [rad/s]; zero where all are alike."""
    apart = np.diff(np.unique(rate))
    apart = apart[apart > _ALIKE * np.max(np.abs(rate), initial=0.0)]
    return float(apart.min()) if apart.size else 0.0
