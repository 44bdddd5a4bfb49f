"""What cannot help ends early: offers far beyond bounds, steps taken for directions, terms stopped by their bounds."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from bench_case import ONE_AXIS, RESONATOR, bench
from lab.die import Hidden

from memsgyro_jax.diagnosis import far_rows, nuisances
from memsgyro_jax.diagnosis.fit import fit_case
from memsgyro_jax.diagnosis.programs import Effort
from memsgyro_jax.diagnosis.promise import FARTHER, Offer, promised
from memsgyro_jax.diagnosis.scans import BEYOND, scan, scans
from memsgyro_jax.diagnosis.search import GLANCE


BENT = Hidden(cubic_stiffness_x=0.5 * RESONATOR.kxx)


@pytest.mark.parametrize(("bound", "gains"), [(1.01, True), (0.5, True), (1.0 / (1.01 * FARTHER), False)])
@pytest.mark.parametrize("sign", [+1.0, -1.0])
def test_what_would_have_to_go_far_beyond_a_bound_promises_nothing(bound, gains, sign):
    """The residual asks for exactly one of the offer."""
    generator = np.random.default_rng(1)
    base, slope = generator.normal(size=(400, 2)), generator.normal(size=(400, 1))
    optimum = SimpleNamespace(jacobian=base, residual=-sign * 30.0 * slope[:, 0], dof=398, chi2=0.0)
    optimum.chi2 = float(optimum.residual @ optimum.residual)
    offer = Offer(30.0 * slope, np.array([-bound]), np.array([bound]), np.array([np.inf]))
    (gain,) = promised(optimum, [offer], 0.05).alone
    clean = slope[:, 0] - base @ np.linalg.lstsq(base, slope[:, 0])[0]
    part = min(1.0, bound)
    assert gain == pytest.approx(gains * part * (2.0 - part) * 900.0 * clean @ clean)


def test_a_strength_that_only_grows_may_be_asked_to_shrink_far():
    """Its bound is where it is absent, which is no excess."""
    slope = np.linspace(-1.0, 1.0, 50)[:, None]
    optimum = SimpleNamespace(jacobian=np.ones((50, 1)), residual=9.0 * slope[:, 0], dof=49, chi2=1e3)
    offer = Offer(slope, np.zeros(1), np.ones(1), np.array([np.inf]))
    assert promised(optimum, [offer], 0.05).alone == (0.0,)


@pytest.mark.parametrize("part", [1.0, 1e-3])
def test_a_range_scores_what_its_clipping_takes_and_not_what_its_shape_would(part):
    """The most that c times the step takes of the misfit, 0 <= c <= 2; a misfit of that shape may be a thousand times
    as large.
    """
    fit = fit_case(bench(protocol=ONE_AXIS, die=RESONATOR, hidden=BENT).case)
    (grid,) = [g for g in scans(fit.case) if g[0].label == "adc_saturation"]
    effect, (readings,) = grid[-1], fit.joint.fitted
    coarse, jacobian = readings.experiment.coarse, fit.optimum.jacobian
    step = np.asarray(coarse.residual(fit.model.with_effect(effect)) - coarse.residual(fit.model))
    clean = step - jacobian @ np.linalg.lstsq(jacobian, step)[0]
    asked = replace(fit.optimum, residual=-clean / part)
    found = scan(fit.model, asked, fit.joint.fitted, [effect])
    times = min(1.0 / part, BEYOND)
    most = (clean @ clean) * times * (2.0 / part - times)
    assert np.linalg.norm(clean) > 1.0
    assert found.score.statistic == pytest.approx(most, rel=1e-6)


def _search(glance, fitted):
    """A search of one candidate, of which fits are told."""
    calls = []

    def refit(places, **more):
        calls.append(more.get("evaluations"))
        return glance if more.get("evaluations") == GLANCE else fitted

    joint = SimpleNamespace(
        together=lambda places: None,
        of_effect=lambda place: np.array([1]),
        bounds=(np.array([-np.inf, -2.0]), np.array([np.inf, 2.0])),
    )
    optimum = SimpleNamespace(chi2=1e4, dof=100, vector=np.zeros(2), free=np.zeros(1))
    return SimpleNamespace(joint=joint, optimum=optimum, refit=refit, level=0.05, given=(), accepted=[]), calls


@pytest.mark.parametrize(("value", "whole"), [(1.99, False), (-1.99, False), (1.2, True)])
def test_a_term_that_stands_at_its_bound_after_a_glance_is_not_fitted_to_its_end(value, whole):
    def end(strength, chi2, converged):
        return SimpleNamespace(vector=np.array([0.0, strength]), chi2=chi2, converged=converged, free=np.zeros(2))

    search, calls = _search(end(value, 3e3, False), end(1.3, 2e2, True))
    score = SimpleNamespace(statistic=8e3)
    ranking = SimpleNamespace(order=(0,), p_values=np.zeros(1), places=(7,), scores=(score,), slopes=(None,))
    stopped: set[int] = set()
    found = nuisances._best(search, ranking, stopped)
    assert calls == ([GLANCE, None] if whole else [GLANCE])
    assert (found is not None) == whole
    assert stopped == (set() if whole else {7})


@pytest.mark.parametrize(
    ("left", "alone", "turns"),
    [
        ((54.0, 53.0, 52.0, 51.0, 50.0, 49.0, 48.0, 47.0), {}, 2),
        ((54.0, 20.0, 19.0, 18.0, 17.0, 16.0, 15.0, 14.0), {}, 3),
        ((54.0, 40.0, 30.0, 20.0, 12.0, 6.0, 3.0, 1.0), {0: (7,)}, 8),
        ((54.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0), {0: (7,)}, 8),
        ((54.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0), {}, 3),
    ],
)
def test_looking_for_rows_far_off_ends_where_it_is_no_way_to_noise(monkeypatch, left, alone, turns):
    """A curve that the model has no law for has other rows far off in every turn, and leaves the same; what is far off
    beside a model that leaves noise is no outlier where none of it stands alone.
    """
    made = []

    def without(fit, optimum, rows):
        made.append(rows)
        return SimpleNamespace(chi2=100.0 * left[len(made) - 1], dof=100)

    monkeypatch.setattr(far_rows, "_beside_all", lambda fit, optimum: SimpleNamespace(optimum=None))
    monkeypatch.setattr(far_rows, "_far", lambda fit: {0: (len(made),)})
    monkeypatch.setattr(far_rows, "_without", without)
    monkeypatch.setattr(far_rows, "far_rows", lambda fit: alone)
    left = (*left, 1.0)  # of the last fit, without those that are named
    fit = SimpleNamespace(optimum=None, deviations=((SimpleNamespace(rows=1000), None),))
    assert far_rows.far_rows_in_turns(fit) == alone
    assert len(made) - bool(alone) == turns == (far_rows.TURNS if alone else turns)


@pytest.mark.parametrize(
    ("left", "accepted", "later", "spent", "searches"),
    [
        (300.0, [1], None, 0, 1),  # the device beside terms, and far from noise: it is no matter of which came first
        (90.0, [1], None, 0, 2),
        (15.0, [1], None, 0, 2),
        (300.0, [], None, 0, 2),  # no effect was tried without the terms
        (300.0, [], None, 2000, 1),
        (150.0, [], None, 1400, 1),
        (90.0, [], None, 0, 1),  # terms of the instrument took nearly all
        (300.0, [1], 300.0, 0, 1),
        (300.0, [1], 90.0, 0, 2),
    ],
)
def test_another_order_is_tried_where_the_first_explains_most(monkeypatch, left, accepted, later, spent, searches):
    joint = SimpleNamespace(programs=SimpleNamespace(effort=Effort(most=1000, spent=spent)))
    base = SimpleNamespace(optimum=SimpleNamespace(chi2=1e7, dof=10_000))

    def search(chi2_per_dof, accepted=()):
        optimum = SimpleNamespace(chi2=1e4 * chi2_per_dof, dof=10_000, leaves_noise=False)
        return SimpleNamespace(optimum=optimum, accepted=list(accepted), joint=joint, base=base, tell=lambda text: None)

    alone = iter([search(500.0), None if later is None else search(later)])
    ends = iter([search(left, accepted), search(0.9 * left, accepted)])
    made = []

    def go_on(*_):
        made.append(next(ends))
        return made[-1], None

    monkeypatch.setattr(nuisances, "best_single", lambda *_: None)
    monkeypatch.setattr(nuisances, "instrument_alone", lambda *_: next(alone))
    monkeypatch.setattr(nuisances, "cost", lambda optimum: optimum.chi2)
    monkeypatch.setattr(nuisances, "_beside", go_on)
    monkeypatch.setattr(nuisances, "wander_at_last", lambda *_: [])
    end, _, rival = nuisances.instrument_first(search(1000.0), None, (), go_on, lambda search: False)
    assert len(made) == searches
    assert (end, rival) == (made[-1], "")
