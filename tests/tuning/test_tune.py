"""Tuning a small loop that compiles in seconds: the optimum is found, lost dies stay alone, a kill loses nothing."""

import json
import re
from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from kept import kept
from tuning_study import STUDY, small_study

import memsgyro_jax as mg
from memsgyro_jax import losses
from memsgyro_jax.app import cli
from memsgyro_jax.base.errors import InputError
from memsgyro_jax.montecarlo.runner import Runner
from memsgyro_jax.tuning import objective
from memsgyro_jax.tuning.objective import Objective, Timing
from memsgyro_jax.tuning.tunable import resolved
from memsgyro_jax.tuning.tune import TRAINING, timing_of


@pytest.fixture(scope="module")
def study(tmp_path_factory):
    return small_study(tmp_path_factory.mktemp("study"))


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("kept")


@pytest.fixture(scope="module")
def tuned(study, folder):
    said = []
    made = mg.tune(**study.tune_arguments, keep=folder, progress=said.append)
    return made, said


def likelihood(study):
    given = study.tune_arguments
    loop = given["loop"].sampled_at(given["sample_rate"])
    tunables = resolved(loop, given["free"], given["sample_rate"], given["duration"])
    own = tunables.chosen([True, True, True, False], tunables.values)
    loss, timing = losses.InnovationLikelihood(given["settle"]), timing_of(given["sample_rate"], given["duration"], 0.0)
    return Objective.of(
        tunables.applied(loop, tunables.values), given["scenario"], given["spread"], own, loss,
        dies=TRAINING + np.arange(16), timing=timing, seed=0,
    )  # fmt: skip


def test_the_truth_is_recovered(tuned):
    made, said = tuned
    found = {number.label: number for number in made.numbers}
    for axis in (0, 1):
        number = found[f"observer.noise_density.{axis}"]
        assert number.value == pytest.approx(20e-9, rel=0.03)
        assert number.fate.startswith("moved x 0.3")
    assert found["observer.process_noise.rate"].value == pytest.approx(1e7, rel=0.3)
    assert "at its upper bound" in found["filter.bandwidth"].fate  # the matched filter leaves nothing to smooth
    assert [stage.loss for stage in made.stages] == ["InnovationLikelihood", "SquaredRateError"]
    assert any("after 2" in sentence for sentence in said)


def test_unseen_dies_fare_as_with_the_matched_filter(tuned, study):
    made, _ = tuned
    matched = study.changed(
        {"observer.noise_density": "20 nV/sqrt(Hz)", "observer.process_noise.rate": "1e7 rad^2/s^3",
         "filter.bandwidth": "200 kHz"}
    )  # fmt: skip
    best = mg.sweep(**{**matched.sweep_arguments, "bound_dies": 0}).data["rate_error_rms"].values
    assert made.after.mean.value == pytest.approx(np.mean(best**2), rel=0.05)
    assert made.ratio.high < 0.2
    assert made.before.consistent is False
    assert made.after.consistent is True
    assert made.warnings == ()


def test_the_result_says_what_it_is(tuned, tmp_path):
    made, _ = tuned
    text = repr(made)
    for words in ("on 16 unseen dies", "after over before", "lost dies", "NIS of x and y", "moved x"):
        assert words in text
    assert "converged" in made.status
    data = kept(made, tmp_path)
    assert list(made.to_pandas()["value"]) == [number.value for number in made.numbers]
    assert np.mean(data["squared_error"].sel(loop="after").values) == pytest.approx(made.after.mean.value)
    assert data.attrs["seed"] == 0
    assert json.loads(json.dumps(made.as_dict(), allow_nan=False))["schema"] == "memsgyro-tuning/1"
    assert made.plot().get_ylabel() == "dies below [%]"


def test_a_killed_call_goes_on_to_the_same_bits(tuned, study, folder, monkeypatch):
    def never(*_):
        raise AssertionError("an evaluation that was kept was computed again")

    monkeypatch.setattr(objective.Objective, "_computed", never)
    monkeypatch.setattr(Runner, "_run", never)
    again = mg.tune(**study.tune_arguments, keep=folder)
    assert [n.value for n in again.numbers] == [n.value for n in tuned[0].numbers]
    assert repr(again) == repr(tuned[0])


def test_the_command_writes_a_study_that_sweeps_to_the_same_figures(tuned, folder, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "small.toml").write_text(STUDY)
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "evaluations").symlink_to(folder)
    with pytest.raises(SystemExit) as end:
        cli.main(["tune", "small.toml", "--out", "out", "--json", "copy.json"])
    assert end.value.code == 0
    assert "after over before" in capsys.readouterr().out
    result = json.loads((tmp_path / "copy.json").read_text())
    assert result == json.loads((tmp_path / "out" / "tuning.json").read_text())
    written = mg.load_study(tmp_path / "out" / "tuned.toml")
    same = zip(*(_leaves(loop) for loop in (written.loop, tuned[0].loop)), strict=True)
    assert all(np.array_equal(a, b) for a, b in same)
    lot = mg.sweep(**{**written.sweep_arguments, "bound_dies": 0})
    assert np.mean(lot.data["rate_error_rms"].values ** 2) == result["after"]["mean"]["value"]


def _leaves(loop):
    return [np.asarray(leaf) for leaf in jax.tree.leaves(eqx.filter(loop, eqx.is_array))]


def test_slopes_are_those_of_finite_differences(tuned, study):
    made = likelihood(study)
    at = made.tunables.values * np.array([0.9, 1.1, 3.0])
    slopes = made.slopes(at).slopes
    for i in range(3):
        step = np.eye(3)[i] * at * 1e-3
        parts = [made.values(at + k * step).loss for k in (-2, -1, 1, 2)]
        difference = (parts[0] - 8 * parts[1] + 8 * parts[2] - parts[3]) / (12e-3 * at[i])
        assert slopes[i] == pytest.approx(difference, rel=1e-6)


def test_a_lost_die_changes_nothing_for_the_others(tuned, study):
    made = likelihood(study)
    start = jnp.asarray(np.where(np.arange(16) == 3, 1.0, np.asarray(made.loop.start[0])))  # a metre off
    lost = replace(made, loop=eqx.tree_at(lambda loop: loop.start[0], made.loop, start))
    whole, some = made.slopes(made.tunables.values), lost.slopes(made.tunables.values)
    others = np.arange(16) != 3
    assert some.alive.tolist() == others.tolist()
    assert np.array_equal(some.loss[others], whole.loss[others])
    assert np.array_equal(some.slopes[:, others], whole.slopes[:, others])
    assert np.all(some.slopes[:, 3] == 0.0)
    total, slope = made.total(some, 100.0)
    assert total == pytest.approx((np.sum(whole.loss[others]) + 100.0) / 16)
    assert slope == pytest.approx(np.sum(whole.slopes[:, others], axis=1) / 16)


@pytest.mark.slow
def test_what_is_switched_off_is_found_again(tuned, study):
    off = study.changed({"observer.process_noise.rate": "0 rad^2/s^3"})
    made = mg.tune(**{**off.tune_arguments, "free": off.tune_arguments["free"][:2]})
    found = {number.label: number for number in made.numbers}
    assert found["observer.process_noise.rate"].value == pytest.approx(1e7, rel=0.3)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"tune.free": ["observer.noise_densty"]}, "`observer.noise_densty` is none (did you mean"),
        ({"tune.free": []}, "must name at least one number"),
        ({"tune.free": [{"path": "filter.bandwidth", "low": "9 Hz", "high": "3 Hz"}]}, "must rise, but 9 to 3"),
        ({"tune.free": [{"path": "filter.bandwidth", "low": "9 kg"}]}, "filter.bandwidth"),
        ({"tune.free": [{"path": "filter.bandwidth", "low": "1 kHz"}]}, "within its bounds 1000 to"),
        ({"tune.free": ["filter", "filter.bandwidth"]}, "freed twice"),
        ({"tune.free": ["scenario.rate.intensity"]}, "is none"),
        ({"tune.free": ["start.1"]}, "must be given bounds"),
        ({"tune.dies": 1}, "greater than or equal to 2"),
        ({"tune.loss": "squared"}, "tune.loss"),
    ],
)  # fmt: skip
def test_what_cannot_be_tuned_is_one_sentence(study, change, message):
    with pytest.raises(InputError, match=re.escape(message)) as error:
        mg.tune(**study.changed(change).tune_arguments)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    "loss",
    [
        losses.ExpectedMisses(0.1),
        losses.ClaimedVariance(5e-4),
        losses.WorstDies(losses.ExpectedMisses(0.1), 0.25),
        losses.Weighted((losses.ClaimedVariance(5e-4), 1.0), (losses.ExpectedMisses(0.1), 1.0)),
    ],
)
def test_a_loss_that_believes_claims_moves_no_filter(study, loss):
    """It moved the noises to their bounds, where the filter claims least."""
    words = f"`{type(loss).__name__}` believes .* must hold no number of the filter, but holds `observer"
    with pytest.raises(InputError, match=words):
        mg.tune(**{**study.tune_arguments, "loss": loss})


@pytest.mark.slow
def test_a_design_value_moves_its_dies(study):
    """Free and varied at once: at a new design the dies are those drawn around it; slopes are those of differences."""
    given, spread = study.tune_arguments, mg.Spread((mg.Vary("start.0", mg.Normal(relative=0.2)),))
    free = mg.free({"start.0": (1e-7, 1e-5)})

    def around(start):
        loop = eqx.tree_at(lambda made: made.start, given["loop"], (jnp.asarray(start), *given["loop"].start[1:]))
        loop = loop.sampled_at(given["sample_rate"])
        tunables = resolved(loop, free, given["sample_rate"], given["duration"])
        return Objective.of(
            loop, given["scenario"], spread, tunables, losses.OutOfTolerance(30.0), dies=np.arange(8),
            timing=Timing(1e-6, 20, 100), seed=0,
        )  # fmt: skip

    here = around(1e-6)
    np.testing.assert_allclose(
        here.values(np.array([1.2e-6])).loss, around(1.2e-6).values(np.array([1.2e-6])).loss, rtol=1e-9
    )
    step = 1e-4
    parts = [np.mean(here.values(np.array([1e-6 * (1 + k * step)])).loss) for k in (-2, -1, 1, 2)]
    difference = (parts[0] - 8 * parts[1] + 8 * parts[2] - parts[3]) / (12 * step)
    slopes = here.slopes(np.array([1e-6])).slopes
    assert np.mean(slopes) * 1e-6 == pytest.approx(difference, rel=1e-6)
    assert difference != 0.0


def test_a_loss_that_is_no_number_at_the_start_is_one_sentence(tuned, study):
    lost = study.changed({"loop.travel": "1e-9 m", "loop.displacement": ["1 um", "0 m"]})
    with pytest.raises(InputError, match="must be a finite number at the start, but it is for none of 16 dies"):
        mg.tune(**lost.tune_arguments)


@pytest.mark.slow
def test_gains_of_classic_loops_are_tuned_and_keep_their_margin():
    """From loops three to five times too slow: of the drive's phase and force and of the rebalance."""
    gyro = mg.SingleMassGyro.from_modes(1e-8, (10e3, 10.3e3), (2000.0, 300.0)).at_temperature(300.0)
    readout = mg.ChargeAmplifier.chi2010()
    control = mg.ClassicControl.force_rebalance(gyro, readout, amplitude=1e-6)
    where = lambda c: (c.drive.phase_gain, c.drive.force_gain, c.sense.integral)  # noqa: E731
    slow = [0.3 * where(control)[0], 0.3 * where(control)[1], 0.2 * where(control)[2]]
    control = eqx.tree_at(where, control, slow)
    loop = mg.ClosedLoop(gyro, readout, mg.NoObserver.for_device(gyro, readout), control, start=(0.0,) * 4)
    names = ("drive.phase_gain", "drive.force_gain", "sense.integral")
    made = mg.tune(
        loop, mg.Step(0.05, np.radians(100.0)), free=mg.free(controller=names), spread=mg.Spread.relative(0.005),
        loss=losses.Weighted((losses.SquaredRateError(0.06), 1.0), (losses.LoopMargin(0.6), 10.0)),
        dies=4, validation_dies=4, report_dies=8, sample_rate=200e3, duration=0.08, settle=0.06, evaluations=10,
    )  # fmt: skip
    assert made.ratio.high < 0.8
    assert float(mg.loop_margins(made.loop).least) > 0.55
