"""Sweeps: the same die is the same die, lost dies stay alone, and a kill loses nothing."""

import json
import os
import pickle
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
import xarray as xr
from harness import PERCENTILES
from kept import kept

import memsgyro_jax as mg
from memsgyro_jax.base.errors import InputError
from memsgyro_jax.montecarlo import batch
from memsgyro_jax.montecarlo.batch import Plan
from memsgyro_jax.montecarlo.bounds import own_bounds
from memsgyro_jax.montecarlo.divergence import divergence_of
from memsgyro_jax.montecarlo.spread import AbstractDistribution


SHORT = {"sample_rate": 100e3, "duration": 0.002, "bound_dies": 0}
SPREAD = mg.Spread.relative(0.15)
SLIGHT = mg.Spread.relative(1e-5)  # what the filter of `small` takes as known hardly differs
FEWER = 19

SCRIPT = """
import sys
from memsgyro_jax import runtime
runtime.configure(devices={devices})
import memsgyro_jax as mg
gyro, readout = mg.SingleMassGyro.chi2010(), mg.ChargeAmplifier.chi2010()
known = tuple(name for name in gyro.model.names if name != "rate")
observer = mg.ExtendedKalmanFilter.for_device(gyro, readout, annealing=mg.Annealing(), known=known)
loop = mg.ClosedLoop(gyro, readout, observer, mg.DampingCompensation(mg.Tone(600.0, 53.95)))
lot = mg.sweep(loop, mg.Spread.relative(1e-5), dies={dies}, chunk=8, sample_rate=100e3, duration=0.002, bound_dies=0,
               out=sys.argv[1], resume=True, progress=lambda done, dies: print(done, flush=True))
"""


@pytest.fixture(scope="module")
def loop() -> mg.ClosedLoop:
    gyro, readout = mg.SingleMassGyro.chi2010(), mg.ChargeAmplifier.chi2010()
    observer = mg.ExtendedKalmanFilter.for_device(gyro, readout, annealing=mg.Annealing())
    return mg.ClosedLoop(gyro, readout, observer, mg.DampingCompensation(mg.Tone(600.0, 53.95)))


@pytest.fixture(scope="module")
def small(loop) -> mg.ClosedLoop:
    """The loop with a filter for motion, offsets and rate alone, where nothing asks the filter: it compiles faster."""
    known = tuple(name for name in loop.device.model.names if name != "rate")
    observer = mg.ExtendedKalmanFilter.for_device(loop.device, loop.readout, annealing=mg.Annealing(), known=known)
    return replace(loop, observer=observer)


@pytest.fixture(scope="module")
def reference(small):
    return mg.sweep(small, SLIGHT, dies=40, chunk=8, **SHORT).to_xarray()


def stored(folder) -> xr.Dataset:
    """The dies on disk, as a user reads them."""
    with xr.open_zarr(folder / "dies.zarr", consolidated=False, mask_and_scale=False) as data:
        return data.load()


def assert_same_bits(left, right, dies):
    assert set(left.data_vars) == set(right.data_vars)
    for name in left.data_vars:
        a, b = left[name].values, right[name].values
        if "die" in left[name].dims:
            a, b = a[:dies], b[:dies]
        assert a.tobytes() == b.tobytes(), name


def test_fewer_dies_are_the_beginning_of_more(small, reference):
    programs = batch._compiled_for_processors._cached._cache_size()
    assert_same_bits(mg.sweep(small, SLIGHT, dies=FEWER, chunk=8, **SHORT).to_xarray(), reference, FEWER)
    assert batch._compiled_for_processors._cached._cache_size() == programs, "one program for any number of dies"


def test_one_core_without_assertions_locale_or_home_gives_the_bits_of_two_devices(reference, fresh_python, tmp_path):
    kept = os.environ.get("XDG_CACHE_HOME", str(Path.home() / ".cache"))  # what does not differ need not be compiled
    one_core = "import os; os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})\n"
    bare = {"XDG_CACHE_HOME": kept, "HOME": "/nowhere", "LC_ALL": "C", "PYTHONCOERCECLOCALE": "0", "PYTHONUTF8": "0"}
    program = one_core + SCRIPT.format(devices=None, dies=40)
    done = fresh_python("-O", "-c", program, str(tmp_path / "one"), **bare)
    assert done.returncode == 0, done.stderr
    assert_same_bits(stored(tmp_path / "one"), reference, 40)


@pytest.mark.parametrize("chunk", [1, pytest.param(5, marks=pytest.mark.slow), 96])
def test_the_chunk_size_changes_nothing(small, reference, chunk):
    assert_same_bits(mg.sweep(small, SLIGHT, dies=6, chunk=chunk, **SHORT).to_xarray(), reference, 6)


@pytest.mark.slow
def test_what_is_known_and_does_not_vary_needs_no_axis_of_dies(loop):
    names = tuple(name for name in loop.device.model.names if name != "kxx")
    known = mg.ExtendedKalmanFilter.for_device(loop.device, loop.readout, known=names, with_offsets=False)
    spread = mg.Spread((mg.Vary("device.kxx", mg.Uniform(relative=0.02)),))
    lot = mg.sweep(eqx.tree_at(lambda made: made.observer, loop, known), spread, dies=3, **{**SHORT, "bound_dies": 1})
    error = lot.to_xarray()["coefficient_error"]
    assert np.all(error.sel(coefficient="sigma") == 0.0)
    assert lot.summary.bound is None


@pytest.mark.slow
def test_without_claims_divergence_is_unknown(small):
    readout = mg.DirectReadout.of_velocity(1e5)
    observer = mg.LyapunovObserver.for_device(small.device, readout)
    made = replace(small, observer=observer, readout=readout)
    found = divergence_of(np.arange(0), np.empty((0, 0)), made, mg.Scenario(), Plan(1e-5, 1, 1, 0.0, 1.0))
    assert found.unjudged == "the observer claims no covariance and no innovations to judge its errors by"
    lot = mg.sweep(small, mg.Spread(), dies=8, chunk=8, **SHORT)
    assert "0 lost, 0 diverged" in repr(lot)
    assert "unknown, because the observer claims" in repr(replace(lot.summary, divergence=found))


@pytest.mark.parametrize("share", [10, *(pytest.param(share, marks=pytest.mark.slow) for share in (1, 50))])
def test_diverging_dies_are_flagged_and_change_no_other(small, reference, share):
    """A die of a thousandth of the mass leaves its travel within the run."""
    dies = 40
    bad = np.random.default_rng(share).choice(dies, max(1, dies * share // 100), replace=False)
    light, slight = Planted(tuple(int(b) for b in bad)), SLIGHT.everywhere
    spread = mg.Spread((mg.Vary("device.mass", light),), everywhere=slight)
    plain = mg.Spread((mg.Vary("device.mass", Planted(())),), everywhere=slight)
    sick = mg.sweep(small, spread, dies=dies, chunk=8, **SHORT)
    well = mg.sweep(small, plain, dies=dies, chunk=8, **SHORT)
    status = sick.to_xarray()["status"].values
    assert np.flatnonzero(status == 1).tolist() == sorted(bad.tolist())
    assert sick.summary.failed == len(bad)
    assert np.all(np.isnan(sick.to_xarray()["rate_error_end"].values[bad]))
    others = np.setdiff1d(np.arange(dies), bad)
    for name in ("rate_error_end", "coefficient_error", "rate_estimate", "nees_end"):
        a, b = sick.to_xarray()[name].values[others], well.to_xarray()[name].values[others]
        assert a.tobytes() == b.tobytes(), name


class Planted(AbstractDistribution):
    """The design's for most dies, a thousandth of it for the dies named: a die's number is read off its place."""

    dies: tuple[int, ...] = eqx.field(static=True)
    seen: list = eqx.field(static=True, default_factory=list)

    def value(self, design, normal):
        first = sum(self.seen)
        self.seen.append(len(normal))
        numbers = np.arange(first, first + len(normal))
        return design * np.where(np.isin(numbers, self.dies), 1e-3, 1.0 + 1e-5 * normal)


def test_a_store_is_what_the_sweep_returns(small, reference, tmp_path):
    lot = mg.sweep(small, SLIGHT, dies=40, chunk=8, out=tmp_path, **SHORT)
    assert json.loads((tmp_path / "summary.json").read_text()) == lot.summary.as_dict()
    assert_same_bits(lot.to_xarray(), reference, 40)
    assert_same_bits(stored(tmp_path), reference, 40)
    assert not np.any(stored(tmp_path)["status"])
    assert list(lot.to_xarray()["coefficient"].values) == list(small.device.model.names)
    drawn = stored(tmp_path)["drawn"]
    assert (drawn.sel(parameter="device.kxx") > 0.0).all()
    assert drawn["parameter_unit"].sel(parameter="device.kxx") == "N/m"
    xr.testing.assert_identical(pickle.loads(pickle.dumps(lot)).to_xarray(), kept(lot, tmp_path))
    assert_same_bits(mg.load(tmp_path), reference, 40)
    drawn = mg.load(tmp_path)["drawn"].sel(parameter="device.kxx")
    assert drawn["parameter_unit"] == "N/m"
    assert np.array_equal(lot.to_pandas()["drawn device.kxx"], drawn)
    (tmp_path / "dies.zarr" / "nis_mean" / "c" / "0").unlink()
    mended = mg.sweep(small, SLIGHT, dies=40, chunk=8, out=tmp_path, resume=True, **SHORT)
    assert_same_bits(mended.to_xarray(), reference, 40)
    assert_same_bits(stored(tmp_path), reference, 40)
    assert "Dies 0 to 39" in mended.notes[0]
    assert mended.notes[0] in repr(mended)


def test_resume_goes_on_and_grows(small, reference, tmp_path):
    mg.sweep(small, SLIGHT, dies=FEWER, chunk=8, out=tmp_path, **SHORT)
    grown = mg.sweep(small, SLIGHT, dies=40, chunk=8, out=tmp_path, resume=True, **SHORT)
    assert_same_bits(grown.to_xarray(), reference, 40)


def test_a_store_of_something_else_is_refused(small, tmp_path):
    mg.sweep(small, SLIGHT, dies=FEWER, chunk=8, out=tmp_path, **SHORT)
    with pytest.raises(InputError, match="--resume"):
        mg.sweep(small, SLIGHT, dies=FEWER, chunk=8, out=tmp_path, **SHORT)
    with pytest.raises(InputError, match="another configuration"):
        mg.sweep(small, mg.Spread.relative(0.1), dies=FEWER, chunk=8, out=tmp_path, resume=True, **SHORT)
    with pytest.raises(InputError, match="another configuration"):
        mg.sweep(small, SLIGHT, dies=FEWER, chunk=8, seed=1, out=tmp_path, resume=True, **SHORT)
    with pytest.raises(InputError, match="blocks of 64"):
        mg.sweep(small, SLIGHT, dies=FEWER, chunk=4, out=tmp_path, resume=True, **SHORT)
    with pytest.raises(InputError, match=f"holds {FEWER} dies"):
        mg.sweep(small, SLIGHT, dies=FEWER - 1, chunk=8, out=tmp_path, resume=True, **SHORT)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"dies": 0}, "`dies`"),
        ({"settle": 0.01}, "`settle`"),
        ({"tolerance": 0.0}, "`tolerance`"),
        ({"chunk": 0}, "`chunk`"),
        ({"duration": -1.0}, "`duration`"),
        ({"sample_rate": 5e3}, "`sample_rate`"),
        ({"sample_rate": float("nan")}, "`sample_rate`"),
    ],
)
def test_bad_settings_are_one_sentence(loop, arguments, words):
    with pytest.raises(InputError, match=words):
        mg.sweep(loop, SPREAD, **{"dies": 8, **SHORT, **arguments})


@pytest.mark.slow
def test_a_killed_sweep_resumes_to_the_same_bits(small, tmp_path):
    clean = {n: v for n, v in os.environ.items() if not n.startswith(("XLA_FLAGS", "JAX_", "MEMSGYRO_"))}
    command = [sys.executable, "-c", SCRIPT.format(devices=2, dies=400), str(tmp_path)]
    environment = clean | {"PYTHONPATH": os.pathsep.join(sys.path)}
    with subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, text=True) as process:
        process.stdout.readline()  # before the first batch
        process.stdout.readline()  # of the first batch
        process.kill()
    whole = mg.sweep(small, SLIGHT, dies=400, chunk=8, **SHORT).to_xarray()
    assert_same_bits(
        mg.sweep(small, SLIGHT, dies=400, chunk=8, out=tmp_path, resume=True, **SHORT).to_xarray(), whole, 400
    )


def test_the_default_lot_is_consistent_and_at_the_bound(loop):
    """The main job: a ratio to the bound of 1 within its sampling error, and a consistent filter."""
    dies = 256  # as the README's example, whose program this is
    lot = mg.sweep(loop, SPREAD, dies=dies)
    figures = lot.summary
    assert figures.failed == 0
    assert figures.divergence.dies == ()
    assert figures.reached.dies == dies
    assert figures.reached.low < figures.ratio_to_bound < figures.reached.high
    assert figures.prior_share == pytest.approx((figures.bound / 3.0) ** 2, rel=1e-12), "3 rad/s are the prior's"
    assert figures.hidden is None
    assert figures.wide is None
    narrow = replace(figures, reached=figures.reached._replace(high=0.6), claim=0.5)
    assert replace(narrow, claim=1.0).wide is None, "what is claimed is right"
    assert "less than the bound" in repr(narrow)
    assert "as different as the filter's prior says" in repr(narrow)
    assert "51 % of what can be known of the rate is the filter's prior" in repr(replace(figures, prior_share=0.51))
    assert figures.ratio_to_bound == pytest.approx(1.0, abs=3.0 / np.sqrt(2 * dies))
    assert figures.reached.median == pytest.approx(1.0, abs=4.0 * 1.17 / np.sqrt(dies))
    assert figures.nees == pytest.approx(14.0, abs=3.0 * np.sqrt(2 * 14 / dies))
    assert figures.nis == pytest.approx(2.0, abs=0.02)
    assert figures.claim_error == pytest.approx(0.002, rel=0.1), "measured: see test_what_few_nodes_cost"
    assert "claims to 0.2 %" in repr(figures)
    few, more = (own_bounds(loop, mg.Scenario(mg.Constant(1.0)), SPREAD, 0, dies, 100e3, 0.1) for dies in (5, 40))
    assert few.tobytes() == more[:5].tobytes()
    assert len(np.unique(more)) == 40
    text = json.loads(json.dumps(figures.as_dict()))
    assert set(text) >= {
        "schema", "dies", "failed", "rate_error_dps", "bound_dps", "ratio_to_bound", "nees", "convergence_time_s",
        "yield", "steps_per_s", "seed", "versions", "diverged", "ratio_to_own_bound", "nees_median", "notes",
    }  # fmt: skip
    for part in ("end", "settled"):
        assert set(text["rate_error_dps"][part]) == PERCENTILES
    assert set(text["yield"]) == {"value", "low", "high", "criterion"}


@pytest.mark.slow
def test_a_varying_rate_is_followed_and_said_so(small):
    noise = mg.ProcessNoise.of(small.device.model, rate=3e3)
    quick = eqx.tree_at(lambda made: made.observer.process_noise, small, noise)
    lot = mg.sweep(
        quick, mg.Spread(), mg.Sine(amplitude=5.0, frequency=20.0), dies=16, duration=0.15, settle=0.05, bound_dies=0
    )
    found = lot.summary.as_dict()["following"]
    assert found["rms_dps"] < 60.0
    assert -1e-3 < found["delay_s"] < 10e-3


@pytest.mark.slow
def test_identical_dies_differ_by_noise_alone(small):
    lot = mg.sweep(small, mg.Spread(), dies=8, chunk=8, **SHORT).to_xarray()
    assert lot.sizes["parameter"] == 0
    assert len(np.unique(lot["rate_error_end"].values)) == 8


def test_results_do_not_depend_on_a_rebuilt_loop(small, reference):
    rebuilt = eqx.tree_at(lambda made: made.device.mass, small, jnp.asarray(1.8e-7))
    assert_same_bits(mg.sweep(rebuilt, SLIGHT, dies=FEWER, chunk=8, **SHORT).to_xarray(), reference, FEWER)


def test_a_filter_refuses_what_it_cannot_use(loop):
    gyro = loop.device
    with pytest.raises(InputError, match="`noise_density`"):
        mg.ExtendedKalmanFilter.for_device(gyro, mg.DirectReadout(1e5))
    with pytest.raises(InputError, match="`process_noise`"):
        mg.ExtendedKalmanFilter.for_device(gyro, process_noise=mg.ProcessNoise((0.0,) * 4, (0.0,) * 2, (1.0,) * 3))
    with pytest.raises(InputError, match="`prior`"):
        mg.ExtendedKalmanFilter.for_device(gyro, prior=mg.design_prior(mg.DualMassGyro.chi2010()))
