"""Parts of a loop that do not suit each other though they may be meant: told in sentences, before a run."""

import numpy as np

from memsgyro_jax.base.concrete import is_concrete
from memsgyro_jax.device.gyro import VX

from .controllers import ClassicControl, SlidingMode
from .controllers.base import AbstractController
from .loop import ClosedLoop
from .own_parts import inner


def unsuited(loop: ClosedLoop) -> tuple[str, ...]:
    """A sentence for an observer that nothing asks, for a rate that nothing measures, and for a swing beyond the
    converter's range; none of traced numbers.
    """
    return (*_idle(loop), *_clipped(loop))


def _idle(loop: ClosedLoop) -> tuple[str, ...]:
    law = inner(loop.controller)
    observer, name = type(loop.observer).__name__, type(law).__name__
    if loop.observer.learns and isinstance(law, ClassicControl | SlidingMode):
        said = (
            f"The rate given out is that of {name}, which measures by itself: {observer} beside it costs time and adds "
            "nothing to it; `mg.NoObserver.for_device(gyro, readout)` takes its place."
        )
        return (said,)
    if not loop.observer.learns and type(law).output is AbstractController.output:
        said = (
            f"The rate given out is zero whatever turns the device: {observer} learns nothing, and {name} measures no "
            "rate by itself; take an observer, `mg.ExtendedKalmanFilter.for_device(gyro, readout)` say, or "
            "`mg.ClassicControl`."
        )
        return (said,)
    return ()


def _clipped(loop: ClosedLoop) -> tuple[str, ...]:
    adc, drive = loop.readout.adc, getattr(inner(loop.controller), "drive", None)
    amplitude, frequency = (getattr(drive, name, None) for name in ("amplitude", "frequency"))
    if adc is None or amplitude is None or frequency is None or not is_concrete(loop.readout, amplitude, frequency):
        return ()
    turn = 2.0 * np.pi * np.asarray(frequency) if loop.readout.signals[0] >= VX else 1.0
    volts = np.abs(loop.readout.scale[0]) * np.asarray(amplitude) * turn + np.abs(loop.readout.offset[0])
    swing, limit = float(np.max(volts)), float(np.min(np.asarray(adc.limit)))
    if swing <= limit:
        return ()
    said = (
        f"The swing of the design reaches {swing:.3g} V at the read-out, but the converter clips at {limit:.3g} V: "
        "amplitude and rate come out wrong, and dies may be lost; lower `amplitude` or `scale`, or widen the "
        "converter's `limit`."
    )
    return (said,)
