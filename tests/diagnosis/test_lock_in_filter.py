"""The filter of a lock-in, of one or more poles, which still shows rows further back."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from bench_case import ONE_AXIS, RESONATOR, bench
from lab.die import Hidden
from lab.faults import Faults
from scipy.linalg import expm

from memsgyro_jax.diagnosis.diagnose import diagnose
from memsgyro_jax.diagnosis.instrument import filters_of
from memsgyro_jax.diagnosis.joint_residual import Joint
from memsgyro_jax.diagnosis.rows_before import behind_filter
from memsgyro_jax.diagnosis.search import start_search
from memsgyro_jax.effects.base import UntilNow
from memsgyro_jax.effects.lock_in_poles import LockInFilter, shares_of
from memsgyro_jax.measurement.linear_start import starting_device
from memsgyro_jax.measurement.readings import model_of, readings_of


DWELL = 5.0  # s from row to row


def case_of(seed=0, hidden=None, **faults):
    protocol = replace(ONE_AXIS, faults=Faults(dwell=DWELL, **faults))
    return bench(hidden or Hidden(), protocol=protocol, die=RESONATOR, seed=seed).case


def searched(case):
    joint = Joint(model_of(case, starting_device(case)), readings_of(case))
    return start_search(case, joint, 0.05, (), lambda text: None)


def chain(poles, tau):
    """x' = A·x of equal poles one behind the other, that begin at one and relax to zero."""
    return (np.diag(np.ones(poles - 1), -1) - np.eye(poles)) / tau


def through(poles, tau, settled, dwell):
    """Rows (n,) behind poles that had settled at the first, by the exponential of their equations."""
    at, out = np.full(poles, settled[0], complex), []
    for value, time in zip(settled, dwell, strict=True):
        at = value + expm(chain(poles, tau) * time) @ (at - value)
        out.append(at[-1])
    return np.array(out)


def rows_of(waits, settled, rates, at):
    """How a motion came about that stands `at` first, of rows of so long, the last of them first."""
    ringing, left = [], np.exp(-rates * waits)
    for value, part in zip(settled, left, strict=True):
        ringing.append(at - value)
        at = value + part * ringing[-1]
    began = np.cumsum(waits[::-1])
    ended = began - waits[::-1]
    column = [np.array(x)[::-1, None] for x in (settled, ringing)]
    square = [np.array(x)[::-1, None, None] for x in (rates, left)]
    return UntilNow(*map(jnp.asarray, (*column, *square, began, ended)))


@pytest.mark.parametrize("poles", [1, 2, 4, 8])
@pytest.mark.parametrize("rings", [False, True])
def test_a_filter_shows_what_its_equations_do(poles, rings):
    """Of a device that rings from row to row, and of one that settles at once, through poles one behind the other."""
    tau, waits = 0.3, np.array([0.2, 0.5, 0.1, 0.7, 0.4])
    settled, rates = np.array([1.0, -0.5j, 2.0, 0.3 + 1j, -1.0]), np.array([1 + 3j, 2.0, 4 - 9j, 1 + 30j, 3.0])
    tail = np.eye(poles + 1)[0] / tau  # of what enters the first pole
    at = np.full(poles + 1, 0.4 + 0.2j)  # the device, and behind each pole
    for value, rate, wait in zip(settled, rates, waits, strict=True):
        steady = np.full(poles + 1, value)
        if not rings:
            at[0] = value
        whole = np.zeros((poles + 1, poles + 1), complex)
        whole[0, 0] = -rate
        whole[1:, 1:] = chain(poles, tau)
        whole[1, 0] = tail[0]
        at = steady + expm(whole * wait) @ (at - steady)
    rows = rows_of(waits, settled, rates, 0.4 + 0.2j)
    rows = rows if rings else replace(rows, ringing=jnp.zeros_like(rows.ringing))
    # What came before had stood there for ever.
    before = UntilNow(jnp.array([[0.4 + 0.2j]]), *(jnp.zeros((1, *s), complex) for s in ((1,), (1, 1), (1, 1))),
                      jnp.array([jnp.inf]), rows.began[-1:])  # fmt: skip
    rows = jax.tree.map(lambda a, b: jnp.concatenate([a, b]), rows, before)
    np.testing.assert_allclose(shares_of(jnp.asarray(tau), poles, rows).of(rows)[0], at[-1], atol=1e-9)


def test_no_time_constant_shows_all_at_once_and_any_has_a_slope():
    rows = rows_of(np.array([0.2, 0.5]), np.array([1.0, -0.5j]), np.array([1 + 3j, 2.0]), 0.4)
    seen = UntilNow.settled_at(jnp.array([1.0 + 2j]))
    np.testing.assert_array_equal(shares_of(jnp.asarray(0.3), 4, seen).of(seen), [1.0 + 2j])
    slope = jax.jacfwd(lambda tau: shares_of(tau, 4, rows).of(rows))(0.3)
    ahead, back = (shares_of(jnp.asarray(0.3 + step), 4, rows).of(rows) for step in (1e-6, -1e-6))
    np.testing.assert_allclose(slope, (ahead - back) / 2e-6, atol=1e-7)


def test_rows_that_are_fitted_know_of_those_that_are_not():
    """Every second row is fitted, and each is what a filter makes of all rows before it, at uneven times."""
    case = case_of()
    records = []
    for record in case.records:
        if record.kind == "frequency_sweep":
            wait = DWELL * (1.0 + 0.3 * np.sin(np.arange(record.rows)))
            record = replace(record, time=np.cumsum(wait))
        records.append(record)
    case = replace(case, records=tuple(records))
    device, poles = model_of(case, starting_device(case)), 3
    tau, (term,) = 0.7 * DWELL, filters_of(case)
    filtered = device.with_effect(LockInFilter(jnp.array([tau]), term.entry, float(poles)))
    compared = 0
    for readings in readings_of(case):
        experiment = readings.experiment
        if getattr(experiment, "every", None) is None:
            continue
        settled, seen = (np.asarray(experiment.every.predict(model))[:, 0] for model in (device, filtered))
        mine = np.asarray(experiment.predict(filtered))[:, 0]
        np.testing.assert_allclose(mine, seen[np.asarray(experiment.place)], rtol=1e-12)
        first = 0
        for record in (r for r in case.records if r.kind == "frequency_sweep"):
            rows = slice(first, first + record.rows)
            waited = np.diff(record.time, prepend=-np.inf)
            waited[0] = 1e3 * DWELL
            expected = through(poles, tau, settled[rows], waited)
            np.testing.assert_allclose(seen[rows], expected, rtol=1e-6, atol=1e-9 * np.abs(expected).max())
            first, compared = first + record.rows, compared + record.rows
    assert compared > 100


@pytest.mark.parametrize(("poles", "tau"), [(1, 0.5 * DWELL), (4, 0.3 * DWELL)])
def test_a_filter_is_found_with_its_lag(poles, tau):
    search = searched(case_of(filter_time=tau, filter_order=poles))
    found = behind_filter(search, search.rank())
    assert [found.joint.model.effects[i].label for i in found.given] == ["lock_in_filter"]
    assert found.optimum.chi2 / found.optimum.dof < 1.7  # that of the case without a fault is 1.49
    tau -= 0.0 if poles == 1 else DWELL / 400  # the bench's stages take steps of a 200th
    mine = found.joint.of_effect(0)
    std = found.optimum.std[np.isin(found.optimum.free, mine)]
    assert abs(found.optimum.vector[mine][0] - tau) < 4 * std[0]
    assert float(found.joint.model.effects[0].poles) == poles


def test_a_settled_bench_has_no_filter():
    search = searched(case_of(phase=0.026))
    assert behind_filter(search, search.rank()) is search


@pytest.mark.slow
@pytest.mark.parametrize("stiff", [0.0, 1.0])
def test_a_filter_of_four_poles_is_the_instruments_and_a_spring_beside_it_the_devices(stiff):
    found = diagnose(None, case_of(hidden=Hidden(cubic_stiffness_x=stiff), filter_time=0.4 * DWELL, filter_order=4))
    assert [term.label for term in found.instrument] == ["lock_in_filter"]
    assert [a.label for a in found.accepted] == (["cubic_stiffness x"] if stiff else [])
    assert found.verdict == ("found" if stiff else "instrument_only")
    assert found.instrument[0].numbers["poles"][0] == 4.0
    assert "poles 4" in found.sentence
