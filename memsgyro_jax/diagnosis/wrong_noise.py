"""A noise that is simply declared wrong: what a model leaves is white and depends on nothing, but has another size."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from .compare import judged
from .fit import CaseFit
from .misfit import check_all


def wrong_noise(fit: CaseFit) -> Mapping[str, float]:
    """Per record whose deviations are too large and nothing else, their size over the declared noise.

    With the noise multiplied by that, no test of the record may fail: neither of whiteness, nor of a dependence on
    anything known, nor of the size in any part of it.
    """
    comparison = judged(fit)
    failed = {check.record for check in comparison.checks if check.failed}
    sizes = {s.record: float(np.sqrt(np.nanmean(s.white**2))) for s in comparison.series if s.record in failed}
    rescaled = [
        replace(s, white=s.white / sizes.get(s.record, 1.0), turned=s.turned / sizes.get(s.record, 1.0))
        for s in comparison.series
    ]
    still = {check.record for check in check_all(rescaled, comparison.level) if check.failed}
    return {record: size for record, size in sizes.items() if size > 1.0 and record not in still}
