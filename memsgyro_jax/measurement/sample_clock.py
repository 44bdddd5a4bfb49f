"""Time of readings that have no column for it: from the rate or step of their samples, as the user or the file says."""

from dataclasses import replace

import numpy as np

from memsgyro_jax.base.errors import InputError
from memsgyro_jax.base.units import to_si

from .column_meaning import role_of
from .formats import SourceColumn, SourceTable
from .formats.steady_step import step_of_samples
from .told_beside import Level


def with_clock(table: SourceTable, given: Level | None) -> SourceTable:
    """The table with a column of time before the others, where it has none, nothing else runs that readings could go
    with, and a rate or a step is told.

    Args:
        table: as read.
        given: rate of the samples, as the user says; `None` where nothing is said.

    Raises:
        InputError: a rate is given for a table with a time of its own.
    """
    running = {role_of(c): c for c in table.columns if c.values.dtype.kind in "iuf" and np.unique(c.values).size > 2}
    if given is not None and "t" in running:
        raise InputError(
            f"{table.path}: option `--sample-rate` is for readings without a time, but `{running['t'].header}` tells "
            "it; leave the option out."
        )
    if {"t", "f"} & {*running} or (given is None and {"T", "V_bias", "rate"} & {*running}):
        return table
    step, name = (1.0 / to_si(*given, "Hz", "--sample-rate"), "") if given else step_of_samples(table.attributes)
    if not step or not table.columns:
        return table
    said = f"time runs from zero in steps of {step:.10g} s, as the file's attribute `{name}` says"
    time = SourceColumn("time", "s", step * np.arange(len(table.columns[0].values)))
    return replace(table, columns=(time, *table.columns), assumed=(*table.assumed, *([said] if name else [])))
