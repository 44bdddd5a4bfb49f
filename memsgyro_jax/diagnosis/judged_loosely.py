"""Records that judge a model by what the others hold too loosely, as a loud decay beside one weak sweep."""

from dataclasses import replace

from memsgyro_jax.measurement.case import Case

from .fit import CaseFit


TAKEN = 0.9  # of what such a record is off beyond its noise, which the uncertainty of the fit takes


def judged_loosely(best: CaseFit) -> tuple[str, ...]:
    """Names of the records that alone deny a model of all that was fitted, and would not once fitted too: its numbers
    are not known well enough to tell what they show. None where a record denies it anyway, or the case says its role.
    """
    fitted = {error.name for error in best.errors if error.role == "fit"}
    left = [error for error in best.errors if not error.explained]
    if not (left and best.leaves_noise) or fitted & {error.name for error in left}:
        return ()
    for error in left:
        over = error.chi2 - error.count
        declared = best.case.record(error.name).role is not None
        if declared or best.beyond_uncertainty(error) - error.count > (1 - TAKEN) * over:
            return ()
    return tuple(error.name for error in left)


def with_these_fitted(case: Case, names: tuple[str, ...]) -> Case:
    """The case with these records fitted too."""
    records = (replace(record, role="fit") if record.name in names else record for record in case.records)
    return replace(case, records=tuple(records))
