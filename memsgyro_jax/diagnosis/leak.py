"""What leaks past a device in proportion to its drive, as through the capacitance of a crystal's electrodes.

Left out, it is drawn as a law: terms of opposite sign that cancel.
"""

import numpy as np

from memsgyro_jax.effects import InstrumentTerm
from memsgyro_jax.effects.lock_in_terms import CapacitiveFeedthrough, LockInFeedthrough

from .backbone import CONSTANT, equations
from .fit import CaseFit
from .instrument import every_term
from .law import is_worth, rms, splines


def leak_past(fit: CaseFit, axis: int) -> tuple[InstrumentTerm, ...]:
    """The term of a leak where the sweeps of several drives show one beside forces that are free of any law, and the
    model has none yet; else nothing.
    """
    if any(isinstance(effect, LockInFeedthrough | CapacitiveFeedthrough) for effect in fit.model.effects):
        return ()
    given = equations(fit, axis)
    if given.others.shape[2] < CONSTANT.stop or not np.ptp(np.abs(given.drive[given.drive != 0])) > 0.0:
        return ()
    constant = given.others[:, 0, CONSTANT] + 1j * given.others[:, 1, CONSTANT]
    leaked = constant * (given.drive / np.max(np.abs(given.drive)))[:, None]
    tables = splines(given)[2]
    plain = given.columns(*tables.values())
    more = np.concatenate([plain, np.stack([leaked.real, leaked.imag], axis=1).reshape(len(plain), -1)], axis=1)
    weight = given.robust(more)
    left, before = (rms(given.solve(columns, weight)[2], weight) for columns in (more, plain))
    if not is_worth(left, before, len(given.amplitude)):
        return ()
    return tuple(term for term in every_term(fit.case) if isinstance(term, LockInFeedthrough))
