"""The constant voltage of a read-out, of which a device that is held beside a case says nothing."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from memsgyro_jax.measurement.model import Model

from .fit import CaseFit


def with_offset_left(held: CaseFit) -> Model:
    """The model of a fit with the constant voltage that it leaves of the waveforms, each row weighed with its noise; as
    it is where there are none.
    """
    total = weight = np.zeros(held.model.axes)
    for number, record in enumerate(held.case.records):
        if record.offset is None:
            continue
        left = record.readings - held.predicted(number)
        std = np.broadcast_to(record.noise_of_rows, left.shape)
        seen = np.isfinite(left) & np.isfinite(std)
        sure = np.where(seen, 1.0 / np.where(seen, std, 1.0) ** 2, 0.0)
        total, weight = total + np.sum(sure * np.where(seen, left, 0.0), axis=0), weight + np.sum(sure, axis=0)
    offset = held.model.offset + np.where(weight > 0, total / np.where(weight > 0, weight, 1.0), 0.0)
    return eqx.tree_at(lambda model: model.offset, held.model, jnp.asarray(offset))
