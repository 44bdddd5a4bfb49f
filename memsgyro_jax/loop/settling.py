"""How long the loops of classic control take to come to rest, by the slowest of their closed poles."""

import math
from typing import Any

import jax
import numpy as np

from memsgyro_jax.base.concrete import is_concrete
from memsgyro_jax.base.errors import InputError
from memsgyro_jax.device.gyro import Inertial
from memsgyro_jax.device.modes import natural_frequencies

from .controllers import ClassicControl, ForceRebalance, OpenSense, PhaseLockedDrive
from .loop import ClosedLoop
from .stability import closed_poles


_RESTED = 6.0  # time constants after which a start is over: 0.25 % is left
_SWINGS = 0.5  # of the amplitude: a loop that starts within it begins with its swing
_MOVING = 3.0  # within which 5 % and more are left
_AROUND = 5.0  # times the mode split, from which on a demodulator lets a loop close around both modes


def settling_time_constant(loop: ClosedLoop) -> float | None:
    """Time constant [s] of the slowest closed pole of a loop in classic control at its design, linearised where the
    device is locked at rest; None for another loop, a lot, and where no pole decays.
    """
    control = loop.controller
    if not (isinstance(control, ClassicControl) and isinstance(control.drive, PhaseLockedDrive)):
        return None
    if not isinstance(control.sense, ForceRebalance | OpenSense):
        return None
    try:
        decay = -closed_poles(loop).real
    except (InputError, np.linalg.LinAlgError):  # a lot; a device without finite numbers
        return None
    rest = 1e-6 * float(np.max(np.asarray(control.drive.demodulator.bandwidth)))
    return float(1.0 / decay.min()) if np.isfinite(decay).all() and decay.min() > rest else None


def swing_up_time(loop: ClosedLoop) -> float:
    """How long [s] the largest force of a phase-locked drive takes to bring the design from its start to its amplitude,
    up from rest or down from a larger swing; zero for another loop, one that starts near it, for numbers that are
    traced, and for a force that never does.
    """
    drive: Any = getattr(loop.controller, "drive", None)
    if not isinstance(drive, PhaseLockedDrive) or not is_concrete(loop.device, loop.start, drive):
        return 0.0
    dynamics = loop.device.dynamics(Inertial())
    damping, gain = (float(np.max(np.asarray(part))) for part in (dynamics.damping[0][0], dynamics.gain[0]))
    amplitude, start = float(np.max(drive.amplitude)), _start(loop)
    holding = damping * 2.0 * np.pi * float(np.max(np.asarray(drive.frequency))) * amplitude / gain
    share = holding / float(np.min(np.asarray(drive.limit)))
    if damping <= 0.0 or abs(start / amplitude - 1.0) <= _SWINGS:
        return 0.0
    if start > amplitude:
        return 2.0 / damping * math.log((start / amplitude + 1.0 / share) / (1.0 + 1.0 / share))
    return -2.0 / damping * math.log1p(-share) if share < 1.0 else 0.0


def _start(loop: ClosedLoop) -> float:
    """Displacement of x [m] at time zero."""
    return float(np.max(np.abs(loop.start[0])))


def _comes_down(loop: ClosedLoop) -> bool:
    """Whether a loop with a phase-locked drive starts with a larger swing than that holds."""
    drive: Any = getattr(loop.controller, "drive", None)
    return isinstance(drive, PhaseLockedDrive) and _start(loop) > (1.0 + _SWINGS) * float(np.max(drive.amplitude))


def duration_to_settle(loop: ClosedLoop, settle: float, duration: float, seen: float = 0.0) -> float:
    """A duration [s] after which the loop rests where the figures begin to count, at the same share of it as `settle`;
    `seen` is the longest start-up that was seen [s].
    """
    time_constant = settling_time_constant(loop)
    needed = max(swing_up_time(loop) + _RESTED * (time_constant or 0.0), 1.2 * seen)
    share = settle / duration if settle > 0.0 else 0.5
    whole = max(needed if needed > settle else 2.0 * settle, 0.0) / share
    digit = 10.0 ** (math.floor(math.log10(whole)) - 1) if whole > 0.0 else 1.0
    return float(f"{math.ceil(whole / digit - 1e-9) * digit:.3g}") if whole > 0.0 else 2.0 * duration


def not_at_rest(loop: ClosedLoop, settle: float, duration: float) -> tuple[str, ...]:
    """A sentence where the figures from `settle` [s] on must be of a start, too; none where nothing is known."""
    time_constant, up = settling_time_constant(loop), swing_up_time(loop)
    if time_constant is None or settle >= up + _MOVING * time_constant:
        return ()
    enough = duration_to_settle(loop, settle, duration)
    said = (
        f"The closed loops come to rest with a time constant of {time_constant:.2g} s at the design"
        f"{_after(loop, up, time_constant)}, but the figures count from {settle:.3g} s on and may be of the start; a "
        f"`duration` of {enough:g} s lets it die away before "
        "(they count from its half on where `settle` is left out)."
    )
    return (said,)


def not_rested(loop: ClosedLoop, duration: float) -> tuple[str, ...]:
    """A sentence where a run of `duration` [s] ends before its loops have come to rest; none of traced numbers."""
    time_constant, up = settling_time_constant(loop) if is_concrete(loop) else None, swing_up_time(loop)
    if time_constant is None or duration >= (enough := up + _MOVING * time_constant):
        return ()
    said = (
        f"The closed loops come to rest with a time constant of {time_constant:.2g} s"
        f"{_after(loop, up, time_constant)}, but the run ends after {duration:.3g} s: it shows their start, which "
        f"{_up_to(enough):g} s and more outlast."
    )
    if up > time_constant and _comes_down(loop):
        said += " A `start` at rest, (0, 0, 0, 0), or with the drive's amplitude needs none of it."
    elif up > time_constant:
        said += " A larger `limit` of the drive's force, or a smaller amplitude, swings up faster."
    elif _limited_by_split(loop):
        said += (
            " What a rebalance loop can do is limited by the sense axis: a demodulator of five times the mode split, "
            "less quality factor, matched modes (`mg.matching_bias`) or an open sense axis are faster."
        )
    return (said,)


def not_rested_first(loop: ClosedLoop, duration: float) -> tuple[str, ...]:
    """`not_rested` unless as much was said before: a loop over parameters says it once, not at each run."""
    with jax.ensure_compile_time_eval():  # a loop of known numbers that a compiled function closes over stays known
        said = not_rested(loop, duration)
        if not said:
            return ()
        times = settling_time_constant(loop) or 0.0, swing_up_time(loop)
    return said if _is_new(float(f"{duration:.1g}"), *(math.frexp(time)[1] for time in times)) else ()


_SAID: set[tuple[float, ...]] = set()  # of which runs it was said: their times within a factor of two


def _is_new(*about: float) -> bool:
    known = about in _SAID
    _SAID.add(about)
    return not known


def _up_to(time: float) -> float:
    """Rounded up to two digits."""
    digit = 10.0 ** (math.floor(math.log10(time)) - 1)
    return float(f"{math.ceil(time / digit - 1e-9) * digit:.3g}")


def _limited_by_split(loop: ClosedLoop) -> bool:
    """Whether a rebalance loop has a demodulator narrower than would close around both modes."""
    control: Any = loop.controller
    if not (isinstance(control, ClassicControl) and isinstance(control.sense, ForceRebalance)):
        return False
    split = float(np.max(np.ptp(natural_frequencies(loop.device.dynamics(Inertial()).stiffness), axis=0)))
    return float(np.min(np.asarray(control.sense.demodulator.bandwidth))) < _AROUND * split


def _after(loop: ClosedLoop, up: float, time_constant: float) -> str:
    """Words for a drive that takes longer than that to bring the swing to its amplitude."""
    if up <= time_constant:
        return ""
    way = f"swing comes down from its start at {_start(loop):.3g} m" if _comes_down(loop) else "drive swings up"
    return f" after the {up:.2g} s in which the {way}"
