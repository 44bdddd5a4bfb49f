"""Sections `[device]` and `[readout]` of a study file: which kinds there are, and the objects they make."""

from typing import Annotated, Any

from pydantic import BeforeValidator, Field

from memsgyro_jax.base.complaints import Source
from memsgyro_jax.base.errors import InputError
from memsgyro_jax.base.quantity import FileSection, field_unit
from memsgyro_jax.device.geometry import Process
from memsgyro_jax.device.gyro import AbstractGyro
from memsgyro_jax.effects import Effect, every_effect
from memsgyro_jax.loop.readout import AbstractReadout
from memsgyro_jax.measurement.model import Model

from .carrier import Carrier
from .layout import DrawnComb, LayoutDevice, ProcessSection
from .masses import DualMass, DualModes, Fitted, SingleMass, SingleModes
from .pickoffs import Capacitive, Charge, FittedReadout, Position, Velocity


def _kind_by_keys(given: Any) -> Any:
    """A device that names a file needs no kind; one with frequencies is given by its modes."""
    if not isinstance(given, dict):
        return given
    if "file" in given:
        return {"kind": "fitted", **given}
    return {**given, "kind": f"{given['kind']}_modes"} if "frequency" in given and given.get("kind") in _BOTH else given


_BOTH = ("single_mass", "dual_mass")
Device = Annotated[
    SingleMass | DualMass | SingleModes | DualModes | LayoutDevice | Fitted,
    Field(discriminator="kind"),
    BeforeValidator(_kind_by_keys),
]


def unit_of_device(part: FileSection, name: str) -> str | None:
    """Unit of number `name` of the device that a section describes, by its modes or by a fit too."""
    if isinstance(part, LayoutDevice):
        return field_unit(LayoutDevice, name)
    return field_unit(SingleMass if isinstance(part, SingleMass | SingleModes | Fitted) else DualMass, name)


Readout = Annotated[
    Charge | Capacitive | DrawnComb | Carrier | Position | Velocity | FittedReadout, Field(discriminator="kind")
]


def readout_of(file: Any, model: Model | None) -> AbstractReadout:
    """The read-out of a `StudyFile`, of the process or of the fitted `model` where it is theirs."""
    if isinstance(file.readout, FittedReadout):
        return file.readout.build(model)
    return file.readout.made(_process_of(file)) if isinstance(file.readout, DrawnComb) else file.readout.build()


def _process_of(file: Any) -> Process:
    return (file.process or ProcessSection()).build()


def device_of(file: Any, source: Source, own: tuple[Effect, ...]) -> tuple[AbstractGyro, Model | None]:
    """The device of a `StudyFile` with its effects, and the fitted model that it comes from."""
    if isinstance(file.device, Fitted):
        with source.section("device", "file"):
            gyro, model = file.device.read(own)
    else:
        with source.section("device"):
            made = (
                file.device.build(_process_of(file)) if isinstance(file.device, LayoutDevice) else file.device.build()
            )
            gyro, model = made, None
    labels, known = [effect.label for effect in gyro.effects], (*every_effect(2), *own)
    for number, entry in enumerate(file.effects):
        with source.section("effects", number, "name"):
            found = entry.found(known)
        with source.section("effects", number, "strength"):
            entry.strength_of(found)
        for name in entry.settings:
            with source.section("effects", number, "settings", name):
                entry.setting_of(found, name)
        with source.section("effects", number, "name"):
            effect = entry.build(known)
            if effect.label in labels:
                raise InputError(f"`{effect.label}` must be given once, but stands twice; add up the strengths")
            labels.append(effect.label)
            gyro = gyro.with_effect(effect)
    return gyro, model
