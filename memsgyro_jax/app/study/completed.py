"""The numbers that a study leaves to its device."""

from typing import Any, TypeVar

import numpy as np

from memsgyro_jax.base.quantity import FileSection
from memsgyro_jax.device.gyro import AbstractGyro
from memsgyro_jax.loop.loop import ClosedLoop
from memsgyro_jax.loop.operation import Operation, usual_duration
from memsgyro_jax.loop.readout import AbstractReadout

from .classic import Classic, Unobserved
from .control import Added, Compensation, Sliding
from .laws import KalmanSettings, LyapunovGains


USUAL_SPREAD = 0.15
File = TypeVar("File", bound=FileSection)


def completed(file: File, gyro: AbstractGyro, readout: AbstractReadout) -> File:
    """The `StudyFile` with what it leaves open but for the duration, which the loop tells (`rested`): how `gyro` behind
    `readout` is usually operated.
    """
    given: Any = file
    usual = Operation.of(gyro, readout, given.loop.travel)
    at_rest = isinstance(given.controller, Classic)
    start = 0.0 if at_rest else usual.amplitude
    law = given.controller
    place = law.displacement if isinstance(law, Sliding) else (start, 0.0)
    loop = _filled(given.loop, displacement=place, travel=usual.travel)
    tone = Added(frequency=f"{float(usual.tone.frequency)!r} Hz", amplitude=f"{float(usual.tone.amplitude)!r} m/s^2")
    sections = {
        "loop": loop,
        "sweep": _filled(given.sweep, sample_rate=usual.sample_rate),
        "observer": _observer(given.observer, usual, loop.displacement[0], given.spread.relative or USUAL_SPREAD),
        "controller": _filled(law, amplitude=usual.amplitude)
        if at_rest
        else _filled(law, **_units(usual))
        if isinstance(law, Sliding)
        else law or Compensation(kind="damping_compensation", tones=(tone,)),
    }
    return file.model_copy(update=sections)


def rested(file: File, loop: ClosedLoop) -> File:
    """`file` with the duration that `loop` asks for, where it is left open."""
    given: Any = file
    return file.model_copy(update={"sweep": _filled(given.sweep, duration=usual_duration(loop))})


def _observer(part: FileSection, usual: Operation, amplitude: float, spread: float) -> FileSection:
    if isinstance(part, LyapunovGains):
        haste = part.annealing and _filled(part.annealing, decay=100.0 * usual.decay)
        return _filled(part.model_copy(update={"annealing": haste}), **_units(usual))
    if isinstance(part, Unobserved):
        return part
    assert isinstance(part, KalmanSettings)
    annealing = part.annealing and _filled(part.annealing, decay=usual.decay)
    prior = _filled(part.prior, spread=spread, amplitude=amplitude)
    return part.model_copy(update={"annealing": annealing, "prior": prior})


def _units(usual: Operation) -> dict[str, float]:
    """What makes the gains of laws that adapt numbers."""
    return {"length": usual.amplitude, "frequency": 2.0 * np.pi * usual.frequency}


def _filled(part: File, **values: Any) -> File:
    """`part` with those of the values that it leaves open."""
    return part.model_copy(update={name: value for name, value in values.items() if getattr(part, name) is None})


def left_to_device(given: Any, file: Any) -> list[str]:
    """What the device settled of a study that left it open, as one sentence or none."""
    open_ = {
        "it starts at {0.loop.displacement[0]:.3g} m": given.loop.displacement is None,
        "is driven by {0.controller.tones[0].amplitude:.4g} m/s^2 at {0.controller.tones[0].frequency:.4g} Hz": (
            given.controller is None
        ),
        "is sampled at {0.sweep.sample_rate:.3g} Hz": given.sweep.sample_rate is None,
        "runs {0.sweep.duration:.3g} s": given.sweep.duration is None,
    }
    found = [text.format(file) for text, is_open in open_.items() if is_open]
    return [f"What the study leaves open follows the device: {', '.join(found)}."] if found else []
