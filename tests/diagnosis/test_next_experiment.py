"""What to measure next: within what was recorded, and it decides as much as was expected when it is carried out."""

from dataclasses import replace
from types import SimpleNamespace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from bench_case import ONE_AXIS, RESONATOR, bench
from lab.faults import Faults

from memsgyro_jax.diagnosis.diagnose import diagnose
from memsgyro_jax.diagnosis.drives import without_rows
from memsgyro_jax.diagnosis.findings import NOTHING, SIGMAS_SEEN, Prospect
from memsgyro_jax.diagnosis.instrument import instrument_terms
from memsgyro_jax.diagnosis.joint_residual import Joint
from memsgyro_jax.diagnosis.next_experiment import (
    Proposal,
    Rivals,
    _shown,
    advice,
    as_recorded,
    expected,
    of_the_unknown,
    plans,
)
from memsgyro_jax.diagnosis.optimum import optimise
from memsgyro_jax.diagnosis.score import basis, score
from memsgyro_jax.diagnosis.search import CONFUSED, always_free
from memsgyro_jax.effects import catalogue
from memsgyro_jax.measurement.drive_levels import goes_one_way
from memsgyro_jax.measurement.experiments.base import BEYOND
from memsgyro_jax.measurement.linear_start import starting_device
from memsgyro_jax.measurement.readings import model_of, readings_of


def case_of(seed=0, protocol=ONE_AXIS, **faults):
    return bench(protocol=replace(protocol, faults=Faults(**faults)), die=RESONATOR, seed=seed).case


# ---- proposals


def proposed(readings):
    """By kind of experiment: text and experiment of each proposal."""
    return {type(r.experiment).__name__: dict(r.experiment.proposals("it")) for r in readings if r.fitted}


def _shapes(experiment):
    return [(np.shape(leaf), leaf.dtype, jax.typeof(leaf).weak_type) for leaf in jax.tree.leaves(experiment)]


@pytest.fixture(scope="module")
def gyro():
    readings = [r for r in readings_of(bench().case) if r.fitted]
    return {type(r.experiment).__name__: r.experiment for r in readings}, proposed(readings)


def test_proposals_stay_within_what_was_recorded(gyro):
    taken, planned = gyro
    assert set(planned) == {"HarmonicSweep", "RingDown", "RateTable", "RawCapture"}
    for kind, texts in planned.items():
        was = taken[kind]
        for text, one in texts.items():
            assert _shapes(one) == _shapes(was), "a compiled program serves both"
            for name in ("force", "forces"):
                if hasattr(was, name):
                    assert np.abs(getattr(one, name)).max() <= BEYOND * np.abs(getattr(was, name)).max(), text
            for name in ("temperature", "bias_voltage", "rate"):
                now, then = (np.asarray(getattr(e.surroundings, name)) for e in (one, was))
                assert np.abs(then).min() * (1 - 1e-12) <= np.abs(now).max() <= np.abs(then).max() * (1 + 1e-12), text
    assert any("-40 °C and 85 °C" in text for text in planned["HarmonicSweep"])
    assert any("5 V and 15 V" in text for text in planned["HarmonicSweep"])


def test_a_device_that_was_never_warmed_is_not_to_be_warmed():
    """Nor biased, nor turned: at 20 mK and at room temperature alike. Without a clock nothing can be done later."""
    (sweep,) = [r.experiment for r in readings_of(case_of()) if r.fitted]
    for kelvin in (0.02, 298.15):
        held = eqx.tree_at(lambda s: s.surroundings.temperature, sweep, jnp.full(sweep.frequency.shape, kelvin))
        texts = [text for text, _ in held.proposals("it")]
        assert not [text for text in texts if "temperature" in text or "bias" in text or "rate" in text]
        assert not [text for text in texts if "at the end" in text]
        assert len(texts) == 5
    cold = sweep.surroundings.temperature * 0 + jnp.linspace(0.02, 0.05, sweep.frequency.size)
    texts = dict(eqx.tree_at(lambda s: s.surroundings.temperature, sweep, cold).proposals("it"))
    assert "repeat the frequency sweeps at temperatures of 0.02 K and 0.05 K, the ends of what was recorded" in texts


def test_the_first_drive_comes_again_after_the_last():
    (sweep,) = [r.experiment for r in readings_of(case_of(dwell=5.0)) if r.fitted]
    late = dict(sweep.proposals("it"))["repeat the first drive level at the end of the record"]
    counted = np.isfinite(late.noise.std[:, 0])
    first = np.asarray(sweep.surroundings.sweep) == 0
    assert counted.sum() == first.sum()
    np.testing.assert_array_equal(late.force[counted], sweep.force[first])
    assert late.surroundings.time[0] >= sweep.surroundings.time.max()


def test_what_is_proposed_is_predicted_also_where_rows_were_left_out():
    """The record was predicted in its place, which has them all: at half the drive as it was."""
    case = case_of()
    (sweep,) = without_rows([r for r in readings_of(case) if r.fitted], {0: (0, 7)})
    joint = Joint(model_of(case, starting_device(case)), [sweep])
    base = optimise(joint, joint.start, joint.base(), joint.fitted)
    half = next(plan for plan in plans(case, [sweep]) if plan.text.endswith("at half the drive"))
    made = as_recorded(joint, base, half.readings)
    assert made is not None
    for experiment in (made.experiment, made.whole):
        np.testing.assert_array_equal(experiment.force, 0.5 * sweep.experiment.force)
        np.testing.assert_array_equal(experiment.measured, made.experiment.measured)
    (left,) = joint.residual(base.vector, [made])
    np.testing.assert_allclose(left, np.asarray(made.experiment.residual(joint.at(base.vector))), atol=1e-6)
    assert np.sqrt(np.mean(left**2)) < 0.1


# ---- scores


def rivals_of(case, first, second):
    """Two models of a case with one effect each, by label, fitted; and all their readings as one residual."""
    known = {e.label: e for e in (*catalogue(1), *instrument_terms(case))}
    model = model_of(case, starting_device(case)).with_effect(known[first], known[second])
    joint = Joint(model, readings_of(case))
    fits = [optimise(joint, joint.start, always_free(joint, [k]), joint.fitted) for k in (0, 1)]
    return joint, Rivals((first, second), *fits)


def carried_out(joint, rivals, planned, seed):
    """Δχ² once an experiment has been made on the model that is the truth, with noise, and both were fitted again."""
    made = as_recorded(joint, rivals.truth, planned)
    std = jnp.where(jnp.isfinite(made.experiment.noise.std), made.experiment.noise.std, 0.0)
    noise = np.random.default_rng(seed).standard_normal((2, *made.experiment.measured.shape))
    measured = made.experiment.measured + std * (noise[0] + 1j * noise[1])
    made = replace(made, experiment=eqx.tree_at(lambda e: e.measured, made.experiment, measured), fitted=True)
    whole = Joint(joint.model, (*joint.readings, made))
    fits = [optimise(whole, fit.vector, fit.free, whole.fitted) for fit in (rivals.truth, rivals.other)]
    return fits[1].chi2 - fits[0].chi2


@pytest.mark.slow
@pytest.mark.parametrize(
    ("first", "second", "faults"),
    [
        pytest.param("reference_phase", "readout_delay", {"phase": -0.026}, marks=pytest.mark.slow),
        ("frequency_drift", "cubic_stiffness x", {"dwell": 5.0, "pull": 1e-3}),
    ],
)
def test_an_experiment_decides_as_much_as_was_expected(first, second, faults):
    """Carried out on the model: by the expected Δχ² ± 2·√Δχ², as a difference of two models scatters."""
    joint, rivals = rivals_of(case_of(**faults), first, second)
    scores = {}
    for plan in plans(bench(die=RESONATOR, protocol=ONE_AXIS).case, joint.readings):
        scores[plan.text], rows = expected(joint, rivals, plan.readings)
        assert rows.shape == (plan.readings.record.size,)
        near = 0.15 * scores[plan.text] + 3.5 * 2 * np.sqrt(scores[plan.text])
        obtained = carried_out(joint, rivals, plan.readings, seed=1)
        assert obtained == pytest.approx(scores[plan.text], abs=near), plan.text
    assert max(scores.values()) > 2 * min(scores.values())


def test_the_advice_is_the_best_or_says_that_none_decides():
    one = Prospect("repeat it", "drift from spring", 3.0, where=", half of it in 2 of 9 rows")
    assert advice(()) is None
    assert advice([one]) == "none of the feasible experiments would tell drift from spring"
    assert advice([replace(one, chi2=36.0)]) == (
        "repeat it; it would tell drift from spring by 6 standard deviations, half of it in 2 of 9 rows"
    )
    assert replace(one, decides=f"a{NOTHING}", chi2=4 * SIGMAS_SEEN**2).told == "a, 2 times weaker"
    assert replace(one, decides=NOTHING, chi2=0.0).told == "nothing new"
    assert advice([replace(one, decides="show a, which these records cannot", shown=1)]) == (
        "repeat it; it would show a, which these records cannot"
    )


def weighed(told, planned, reading=100.0):
    """Expected Δχ² of the one effect that is left, from its slopes in rows that were read and in rows that are planned,
    beside one parameter; `reading` is the largest [standard deviations].
    """
    free = np.ones((told.size, 1))
    mine = score(np.zeros(told.size), basis(free), told[:, None])
    noise = SimpleNamespace(std=1.0)

    def rows(count):
        experiment = SimpleNamespace(measured=np.full((count, 1), reading), noise=noise)
        return SimpleNamespace(experiment=experiment, record=np.zeros(count, int))

    joint = SimpleNamespace(
        start=np.zeros(2), fitted=[rows(told.size)], of_effect=lambda place: np.array([1]),
        model=SimpleNamespace(effects=[SimpleNamespace(label="late")]),
        linearise=lambda *_: (np.zeros(planned.size), np.column_stack([np.ones(planned.size), planned])),
    )  # fmt: skip
    optimum = SimpleNamespace(vector=np.zeros(2), jacobian=free, free=np.array([0]))
    ranking = SimpleNamespace(scores=[mine], places=[0], order=[0], slopes=[told[:, None]])
    weigh = _shown(SimpleNamespace(joint=joint, optimum=optimum), ranking)
    return weigh(Proposal("it", rows(planned.size)))


def test_slopes_that_leave_what_they_are_slopes_of_promise_nothing():
    """Two rows beside a fall from branch to branch promised 5e20, and an effect "5e+09 times weaker"."""
    slopes = np.sin(np.arange(50.0))
    again, least = weighed(slopes, slopes), SIGMAS_SEEN / np.linalg.norm(slopes - slopes.mean())
    assert again.chi2 == pytest.approx(2 * SIGMAS_SEEN**2, rel=0.05)
    falls = slopes.copy()
    falls[20:22] = 4e14, -3e13
    assert weighed(slopes, falls).chi2 == pytest.approx(again.chi2, rel=0.1)
    falls[20:22] = 1.1e3 / least  # no more than is read, but far more than any row beside
    assert weighed(slopes, falls, reading=1e4).chi2 == pytest.approx(again.chi2, rel=0.1)
    much = weighed(slopes, 1e6 * slopes).chi2  # where all rows grow, each is worth what is read of it at most
    assert again.chi2 / 2 <= much <= again.chi2 / 2 + 50 * 100.0**2
    assert weighed(slopes, 10 * slopes).chi2 == pytest.approx(101 * SIGMAS_SEEN**2, rel=0.05)


def test_an_effect_that_the_records_hold_at_no_strength_they_could_read_is_left_out():
    """Nearly a copy of what is free: to show, it would move each row by more than there is."""
    slopes = 1.0 + 1e-4 * np.sin(np.arange(50.0))
    told = weighed(slopes, np.sin(np.arange(50.0)))
    assert (told.chi2, told.told) == (0.0, "nothing new")


def test_where_nothing_explains_the_records_no_standard_deviations_are_promised():
    """What an experiment would show is predicted by models that explain what was recorded, or not at all."""
    case = case_of()
    said = of_the_unknown(case)
    assert "none is predicted" in said
    assert "at a lower one" in said
    assert "standard deviations" not in said
    assert "drives" not in of_the_unknown(replace(case, records=()))


@pytest.mark.parametrize(
    ("drives", "one_way"),
    [((1.0, 2.0, 3.0), True), ((3.0, 3.0, 1.0), True), ((1.0, 2.0, 1.0), False), ((1.0, 1.02, 1.0), False)],
)
def test_a_drive_that_goes_one_way_in_time_is_repeated_at_the_end(drives, one_way):
    sweep = replace(ONE_AXIS.experiments[0], values=drives)
    without_clock = case_of(protocol=replace(ONE_AXIS, experiments=(sweep,))).records[0]
    record = replace(without_clock, time=np.arange(len(without_clock.drive), dtype=float))
    assert not goes_one_way(without_clock)
    assert goes_one_way(record) is one_way
    said = of_the_unknown(replace(case_of(), records=(record,)))
    assert ("repeat the first drive at the end" in said) is one_way


@pytest.mark.slow
def test_in_the_laboratory_the_advised_record_decides_and_the_last_of_the_list_does_not():
    told = diagnose(None, case_of(phase=-0.026))
    assert "cannot tell it from readout_delay" in told.sentence
    best, worst = told.next_experiments[0], told.next_experiments[-1]
    assert (best.experiment, worst.experiment) == (
        "repeat the frequency sweeps at 2 times the drive", "repeat the frequency sweeps at half the drive",
    )  # fmt: skip
    assert best.chi2 > 25 > CONFUSED > worst.chi2
    for times, decided in ((2.0, True), (0.5, False)):
        more = replace(ONE_AXIS.experiments[0], name="more", role="fit")
        more = replace(more, values=tuple(times * value for value in more.values))
        again = diagnose(
            None, case_of(protocol=replace(ONE_AXIS, experiments=(*ONE_AXIS.experiments, more)), phase=-0.026)
        )
        assert [term.label for term in again.instrument] == ["reference_phase"]
        assert ("cannot tell" not in again.sentence) == decided
