"""A start from the data alone lands near the device, whatever the design said."""

from dataclasses import replace

import numpy as np
import pytest
from bench_case import DIE, RESONATOR, bench, truth
from lab.die import Hidden
from lab.protocol import Laboratory, Multisine, Sweep
from lab.strengths import visible

from memsgyro_jax.measurement.linear_start import design_device, starting_device


SWEPT = Sweep("sweep", 0, (0.002, 0.006), points=15, span=25.0, dense=4.0, both=False, noise=1e-4)


def miss(found, true):
    """Errors of stiffness, damping (coupling entries against their own axes') and mobility, relative."""

    def against_axes(entries):
        entries = np.asarray(entries)
        return entries if entries.size == 1 else np.append(entries[:2], np.sqrt(entries[0] * entries[1]))

    pairs = [(getattr(found, name), getattr(true, name)) for name in ("stiffness", "damping")]
    parts = [np.abs(np.asarray(a) - np.asarray(b)) / against_axes(b) for a, b in pairs]
    return *(part.max() for part in parts), abs(float(found.mobility / true.mobility) - 1)


def only(case, *names):
    return replace(case, records=tuple(r for r in case.records if r.name in names))


@pytest.mark.parametrize(
    "hidden", [(), ("cubic_stiffness_x",), pytest.param(("readout_delay",), marks=pytest.mark.slow)]
)
def test_a_gyro_starts_from_its_sweeps(hidden):
    made = bench(visible(*hidden))
    true = truth(made.case, DIE, Hidden(), ()).device
    stiffness, damping, mobility = miss(starting_device(made.case), true)
    assert stiffness < 1e-4
    assert damping < 0.03
    assert mobility < 0.02
    assert max(miss(design_device(made.case), true)) > 0.04, "the design alone is no such start"


@pytest.mark.parametrize("name", ["sweep_x", "sweep_y"])
def test_one_driven_axis_is_enough(name):
    """The other axis moves too, by the coupling."""
    made = bench()
    stiffness, damping, mobility = miss(
        starting_device(only(made.case, name)), truth(made.case, DIE, Hidden(), ()).device
    )
    assert stiffness < 1e-3
    assert damping < 0.1
    assert mobility < 0.05


@pytest.mark.parametrize("experiment", [Multisine("multisine", samples=1024), SWEPT])
def test_a_resonator_starts_from_any_of_its_records(experiment):
    made = bench(protocol=Laboratory((experiment,)), die=RESONATOR)
    stiffness, damping, mobility = miss(starting_device(made.case), truth(made.case, RESONATOR, Hidden(), ()).device)
    assert stiffness < 5e-4
    assert damping < 0.03
    assert mobility < 0.03


def test_the_design_does_not_matter():
    made = bench()
    wrong = {
        n: replace(v, value=2.0 * v.value, low=2.0 * v.low, high=2.0 * v.high) if n[0] == "d" else v
        for n, v in made.case.design.items()
    }
    one, other = starting_device(made.case), starting_device(replace(made.case, design=wrong))
    np.testing.assert_array_equal(one.damping, other.damping)


def test_validation_records_are_not_looked_at():
    made = bench()
    spoilt = [
        replace(r, role="validation", phasors=np.full_like(r.phasors, 1e3)) if r.name == "sweep_y" else r
        for r in made.case.records
    ]
    without = [r for r in made.case.records if r.name != "sweep_y"]
    one, other = (starting_device(replace(made.case, records=tuple(records))) for records in (spoilt, without))
    np.testing.assert_array_equal(one.stiffness, other.stiffness)


@pytest.mark.parametrize("name", ["ringdown", "rate", "raw"])
def test_where_the_records_do_not_hold_the_device_it_starts_at_the_design(name):
    """A ring-down offers no phasors, a table one frequency, 3 ms of a raw capture no resonance of 100 ms."""
    made = bench()
    found, design = starting_device(only(made.case, name)), design_device(made.case)
    np.testing.assert_array_equal(found.stiffness, design.stiffness)
    np.testing.assert_array_equal(found.damping, design.damping)
    assert float(found.mobility) == float(design.mobility) == 1 / made.case.design["mass"].value
