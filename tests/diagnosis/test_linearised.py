"""Calls of the programs of a fit that are spared: what is known of a vector is not asked again."""

import numpy as np
import pytest
from bench_case import bench

from memsgyro_jax.diagnosis import linearised
from memsgyro_jax.diagnosis.drives import without_rows
from memsgyro_jax.diagnosis.joint_residual import Joint
from memsgyro_jax.diagnosis.linearised import Linear
from memsgyro_jax.measurement.readings import readings_of


def test_slopes_along_sums_of_known_directions_are_sums_of_slopes():
    """Parameters differ by fourteen powers of ten, and the known directions are far from square to each other."""
    generator = np.random.default_rng(1)
    jacobian, scale = generator.normal(size=(7, 40)), 10.0 ** np.array([8, -4, 2, 10, 0, -3, 5])
    block = np.zeros((12, 7))
    block[:5] = generator.normal(size=(5, 7)) @ np.diag(np.array([1, 1, 1, 1, 1, 0, 0])) * scale
    made = Linear(None, block, np.zeros(40), (block / scale) @ jacobian, None)
    wanted = np.zeros((12, 7))
    wanted[:3] = (generator.normal(size=(3, 5)) @ np.eye(5, 7)) * scale
    found = made.along(wanted)
    np.testing.assert_allclose(found.slopes, (wanted / scale) @ jacobian, atol=1e-9)
    assert made.along(None) is made
    assert found.along(block) is None, "two directions of five are lost"
    spoilt = made.slopes.copy()
    spoilt[4, 7] = np.nan
    assert made._replace(slopes=spoilt).along(wanted) is None, "sums would spread what is no number"
    wanted[2, 6] = 1e-3 * scale[6]
    assert made.along(wanted) is None, "one that was not asked for"


def test_a_fit_without_some_rows_asks_no_program_for_what_is_known(monkeypatch):
    case = bench().case
    joint = Joint(bench().model(()), [r for r in readings_of(case) if r.fitted][:1])
    free = joint.base()
    units, calls, plain = np.eye(joint.start.size)[free], [], linearised._linearise

    def counted(*given):
        calls.append(given)
        return plain(*given)

    monkeypatch.setattr(linearised, "_linearise", counted)
    value, slopes = joint.linearise(joint.start, units, joint.fitted)
    number = int(joint.fitted[0].record[3])
    fewer = without_rows(joint.fitted, {number: (int(joint.fitted[0].row[3]),)})
    assert fewer[0].record[3] == -1
    less, along = joint.linearise(joint.start, 2.0 * units, fewer)
    assert len(calls) == 1
    gone = fewer[0].weightless
    assert 0 < gone.sum() < gone.size
    np.testing.assert_array_equal(less, np.where(gone, 0.0, value))
    np.testing.assert_allclose(along, np.where(gone[:, None], 0.0, 2.0 * slopes), rtol=1e-12)
    # As the experiment itself, in which the rows have no weight, says.
    again = Joint(joint.model, fewer)
    own = again.calls.linear(again._part(joint.start, units), joint.start, fewer[0].experiment)
    np.testing.assert_allclose(own.value, less, atol=1e-9)


@pytest.mark.parametrize("block", [None, np.zeros((12, 3))])
def test_a_residual_alone_tells_no_slopes(block):
    assert Linear(None, None, np.zeros(4), np.zeros((0, 4)), None).along(block) is None


def test_what_a_prediction_asked_is_kept_of_the_last_call_alone_and_asked_for_again_where_it_is_wanted(monkeypatch):
    """Of a raw record it is hundreds of megabytes, and a fit makes tens of calls."""
    case = bench().case
    joint = Joint(bench().model(()), [r for r in readings_of(case) if r.fitted][:1])
    (readings,), calls, plain = joint.fitted, [], linearised._linearise

    def counted(*given):
        calls.append(plain(*given))
        return calls[-1]

    monkeypatch.setattr(linearised, "_linearise", counted)
    moved = joint.start * (1.0 + 1e-6)
    first = joint.asked(joint.start, readings)
    assert joint.asked(joint.start, readings) is first
    assert first is not None
    joint.residual(moved, [readings])
    joint.residual(joint.start, [readings])  # of which the numbers are still known
    held = [part.inquiry for part in (*joint.calls._kept.values(), *(part for _, part in joint.calls._last.values()))]
    assert sum(inquiry is not None for inquiry in held) == 1
    assert len(calls) == 2
    again = joint.asked(joint.start, readings)
    assert len(calls) == 3
    np.testing.assert_array_equal(again.forced[0].state, first.forced[0].state)
