"""From a measurement case to experiments that predict it, reading by reading.

Records of one kind that run through one program are laid together, and experiments are named by their kind (a name is
structure), so that few programs have to be compiled. Every reading keeps the number of its record and whether it may be
fitted: what is not fitted validates.
"""

import numpy as np

from memsgyro_jax.base.errors import InputError
from memsgyro_jax.device.normalised import NormalisedDevice

from .case import Case
from .experiments import Readings
from .model import Model
from .one_place import in_another_place


def readings_of(case: Case) -> tuple[Readings, ...]:
    """The readings of a case, in SI, each with its noise.

    Fitted are records with the role "fit", and without a declared role what its kind says: every second row of a
    frequency sweep, rate tables, raw captures; ring-downs, and the earlier half of free decays, only where nothing else
    holds the device, or was taken at their temperature and bias voltage. The others validate.
    """
    others = [record for record in case.records if record.role != "validation" and not record.last_resort]
    alone = [
        not others or (record.last_resort and in_another_place(case.environment, record, others))
        for record in case.records
    ]
    out = []
    for kind in dict.fromkeys(type(record) for record in case.records):
        mine = [(number, record) for number, record in enumerate(case.records) if type(record) is kind]
        for lonely in (False, True):
            if records := [(number, record) for number, record in mine if alone[number] == lonely]:
                out += kind.laid_out(case, records, lonely)
    return tuple(out)


def roles_of(case: Case) -> tuple[str, ...]:
    """What the rows of each record of a case are for: "fit", "validation", or "both"."""
    laid = readings_of(case)
    fitted, judging = (np.concatenate([[-1], *(r.record for r in laid if r.fitted == sort)]) for sort in (True, False))
    return tuple(("both" if k in judging else "fit") if k in fitted else "validation" for k in range(len(case.records)))


def _offset(case: Case) -> np.ndarray:
    """Constant voltage of each channel as the waveforms show it, where a record has any: a start for the fit, and the
    value where only records that are not fitted see it.
    """
    offsets = [offset for record in case.records if (offset := record.offset) is not None]
    return np.mean(offsets, axis=0) if offsets else np.zeros(case.channels)


def model_of(case: Case, device, **more) -> Model:
    """The base model of a case around `device`, with the declared read-out and reference conditions.

    **Raises:** `InputError` where the device has another number of axes than the case has channels.
    """
    axes = NormalisedDevice.of(device).axes
    if axes != case.channels:
        raise InputError(
            f"Argument `model` must have as many axes as the case {case.name} has channels, {case.channels}, "
            f"but has {axes}."
        )
    return Model(
        device,
        scale=case.readout.scale,
        offset=more.pop("offset", _offset(case)),
        reference_temperature=case.environment.temperature,
        reference_bias=case.environment.bias_voltage,
        order=case.readout.order,
        holds_gain=case.holds_gain,
        **more,
    )
