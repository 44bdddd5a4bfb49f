"""A long sweep of one axis at two levels, with rows that are wrong."""

from dataclasses import replace

import numpy as np
from bench_case import BAND, RESONATOR, bench
from lab.die import Hidden
from lab.protocol import Laboratory, Sweep


LONG = Laboratory((Sweep("sweep", 0, (0.002, 0.006), **BAND | {"points": 90}),), digits=17)


def case_of(seed, hidden=Hidden(), rows=(), sigmas=15.0):  # noqa: B008
    """The case, with some rows that are wrong by so many standard deviations."""
    case = bench(hidden, seed, LONG, RESONATOR).case
    (record,) = case.records
    phasors = record.phasors.copy()
    turn = np.exp(2j * np.pi * np.random.default_rng(seed).random(len(rows)))
    phasors[list(rows), 0] += sigmas * record.noise_std * turn
    return replace(case, records=(replace(record, phasors=phasors),))
