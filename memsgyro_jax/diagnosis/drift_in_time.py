"""Whether a decay tells a law from a drift: both its amplitude and its time run one way, and nothing else does."""

import numpy as np

from memsgyro_jax.effects.instrument import FrequencyDrift

from .fit import CaseFit, beside_case
from .joint_residual import Joint
from .optimum import optimise


def with_drift_alone(base: CaseFit) -> CaseFit | None:
    """The base model with nothing but a frequency that drifts evenly over each record; `None` where a fitted record is
    driven, beside which drifts are tried as terms of the instrument, or none has a clock.
    """
    times = [getattr(record, "time", None) for record in base.case.records]
    if any(r.experiment.driven for r in base.joint.fitted) or not any(t is not None for t in times):
        return None
    begin = np.array([0.0 if t is None else t[0] for t in times])
    span = np.array([1.0 if t is None else t[-1] - t[0] for t in times])
    drift = FrequencyDrift(np.zeros(len(times)), np.eye(len(times))[:, None], begin, span)
    joint = Joint(base.model.present.with_effect(drift), base.joint.readings)
    places = np.array([i for i in range(joint.start.size) if i not in joint.idle])
    found = optimise(joint, joint.start, places, joint.fitted)
    return beside_case(base.case, joint, found)
