"""What every observer and every controller must be, whatever its kind: named in a study file, blind to the truth,
differentiable, the same for one die and for many, and whole from a wrong start.

A new kind gets a line in `memsgyro_jax/app/kinds.py` and an entry in `STUDIES`.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from harness import Keep, everything, run_kept

import memsgyro_jax as mg
from memsgyro_jax.app.kinds import KINDS
from memsgyro_jax.app.study.control import Controller
from memsgyro_jax.app.study.laws import Observer
from memsgyro_jax.loop import noise
from memsgyro_jax.loop.observers import AbstractCovarianceObserver, Clock
from memsgyro_jax.loop.scenario import as_scenario
from memsgyro_jax.tuning.tunable import resolved


VELOCITY = {"kind": "velocity", "scale": "5 V*s/m", "offset": ["1 mV", "-2 mV"], "noise_density": "1 uV/sqrt(Hz)"}
SWING = [{"frequency": f"{f} kHz", "amplitude": "1 um", "phase": "90 deg", "axis": a} for f, a in ((3, "x"), (5, "y"))]
ENERGY = {"frequency": ["3 kHz", "5 kHz"], "amplitude": ["1 um", "0.5 um"]}
KNOWN = ["kxx", "kyy", "kxy", "dxx", "dyy", "dxy", "sigma"]
STUDIES = {
    ("lyapunov", "open_loop"): {
        "observer": {"kind": "lyapunov", "gain": 20, "start": 0.9},
        "controller": {"kind": "open_loop", "tones": [{"frequency": "3 kHz", "amplitude": "1 nN", "axis": "x"}]},
    },
    ("lyapunov", "damping_compensation"): {
        "observer": {"kind": "lyapunov", "gain": 20, "known": ["sigma"], "annealing": {"excess": 9}},
        "controller": {"kind": "damping_compensation", "ahead": True,
                       "tones": [{"frequency": "600 Hz", "amplitude": "5 m/s^2"}]},
    },
    ("energy_lyapunov", "reference_model"): {
        "observer": {"kind": "energy_lyapunov", "gain": 20, "start": 0.9, "energy": ENERGY},
        "controller": {
            "kind": "reference_model", "frequency": ["3 kHz", "5 kHz"], "energy": {**ENERGY, "gain": "9425 1/s"}
        },
    },
    ("ekf", "designed_motion"): {
        "observer": {"kind": "ekf", "known": KNOWN, "with_offsets": False},
        "controller": {"kind": "designed_motion", "tones": SWING},
    },
    ("scale_ratio", "damping_compensation"): {
        "observer": {"kind": "scale_ratio", "known": KNOWN, "with_offsets": False},
        "controller": {"kind": "damping_compensation", "tones": [{"frequency": "600 Hz", "amplitude": "5 m/s^2"}]},
    },
    ("block_ekf", "damping_compensation"): {
        "observer": {"kind": "block_ekf", "start": 8, "length": 8, "tones": ["600 Hz"], "known": KNOWN,
                     "with_offsets": False},
        "controller": {"kind": "damping_compensation", "tones": [{"frequency": "600 Hz", "amplitude": "5 m/s^2"}]},
    },
    ("rate_slope", "damping_compensation"): {
        "observer": {"kind": "rate_slope", "slope": "1000 deg/s^2", "walk": "1 rad^2/s^5", "known": KNOWN,
                     "with_offsets": False},
        "controller": {"kind": "damping_compensation", "tones": [{"frequency": "600 Hz", "amplitude": "5 m/s^2"}]},
    },
    ("known_rate", "damping_compensation"): {
        "observer": {"kind": "known_rate", "until": "0.1 ms", "known": KNOWN, "with_offsets": False},
        "controller": {"kind": "damping_compensation", "tones": [{"frequency": "600 Hz", "amplitude": "5 m/s^2"}]},
    },
    ("none", "sliding_mode"): {"controller": {"kind": "sliding_mode", "start": 0.9, "tones": SWING},
                                "actuators": {"limit": "200 uN"}},
    ("ekf", "whole_angle"): {
        "observer": {"kind": "ekf", "known": KNOWN, "with_offsets": False, "jump": {"damping": "10 1/s"},
                     "process_noise": {"rate": "1 rad^2/s^3"}},
        "controller": {"kind": "whole_angle", "frequency": "3 kHz",
                       "rocking": {"frequency": "100 Hz", "amplitude": "1.2 rad"}},
    },
    ("none", "classic"): {"controller": {"kind": "classic", "sense": "rebalanced", "amplitude": "1 um"}},
}  # fmt: skip
SAMPLES, DIES = 40, np.array([0, 1, 2])
NEW = [("energy_lyapunov", "reference_model")]  # the others have these tests elsewhere too


def kinds_of(union) -> list[str]:
    """Kinds that sections of a study can have."""
    return [part.model_fields["kind"].annotation.__args__[0] for part in union.__args__[0].__args__]


@pytest.mark.parametrize(("part", "union"), [("observer", Observer), ("controller", Controller)])
def test_help_and_study_files_know_the_same_kinds(part, union):
    place = ("observer", "controller").index(part)
    assert list(KINDS[part]) == kinds_of(union)
    assert set(KINDS[part]) == {kinds[place] for kinds in STUDIES}, "every kind must pass the tests below"


@pytest.mark.parametrize("kinds", STUDIES, ids=" and ".join)
def test_a_covariance_has_a_row_for_each_state(kinds):
    """Nobody asks the package's own observers before a run, as those from outside are asked."""
    observer = study_of(kinds).loop.observer
    if isinstance(observer, AbstractCovarianceObserver):
        found = jax.eval_shape(lambda: observer.covariance(observer.init())).shape
        assert found == (len(observer.states),) * 2


def study_of(kinds):
    return mg.default_study().changed({"readout": VELOCITY, "observer": {"kind": "none"}, **STUDIES[kinds]})


@pytest.fixture(
    scope="module",
    params=[kinds if kinds in NEW else pytest.param(kinds, marks=pytest.mark.slow) for kinds in STUDIES],
    ids=" and ".join,
)
def study(request):
    return study_of(request.param)


@pytest.fixture(scope="module")
def loop(study):
    return study.loop.sampled_at(200e3)


def rows(loop, dies=1, design=None):
    """Truth (4), volts (2), forces (2) and what is estimated after every sample, and who was never lost."""
    words = noise.die_words(jax.random.key(3), jnp.asarray(dies))
    estimate = (design or loop).estimate((design or loop).init())
    count = 14 + len(estimate.theta) + 2 * (estimate.rate_variance is not None)
    keep = Keep(everything, tuple(jnp.zeros(()) for _ in range(count)))
    done = run_kept(loop, as_scenario(0.5), words, jnp.asarray(200e3), SAMPLES, 1, keep, design)
    return jnp.stack(done.outputs, axis=1), done.alive


def test_a_die_is_the_same_alone_and_in_a_batch(loop):
    factors = jnp.array([0.8, 1.0, 1.3])
    made = lambda by: eqx.tree_at(lambda tree: tree.device.kxx, loop, loop.device.kxx * by)  # noqa: E731
    together, _ = rows(made(factors), DIES, loop)
    for die in DIES:
        alone, _ = rows(made(factors[die]), die)
        size = np.max(np.abs(alone), axis=0)
        np.testing.assert_allclose(together[..., die] / size, alone / size, atol=1e-9)


def test_the_truth_is_never_seen(loop):
    """A device that moves twice as far behind a read-out of half the scale gives the same volts, so the same all."""
    numbers = lambda made: [getattr(made.device, name) for name in ("mass", "kxx", "kyy", "kxy", "dxx", "dyy", "dxy")]  # noqa: E731
    light = eqx.tree_at(numbers, loop, [0.5 * value for value in numbers(loop)])
    twice = eqx.tree_at(lambda tree: tree.start, light, tuple(2.0 * value for value in loop.start))
    twice = eqx.tree_at(lambda tree: tree.readout.scale, twice, tuple(0.5 * value for value in loop.readout.scale))
    (plain, _), (other, _) = rows(loop), rows(twice)
    np.testing.assert_allclose(other[:, :4], 2.0 * plain[:, :4], rtol=1e-9)
    size = np.max(np.abs(plain[:, 4:]), axis=0)
    np.testing.assert_allclose(other[:, 4:] / size, plain[:, 4:] / size, atol=1e-9)


def test_a_wrong_start_leaves_no_nan(loop):
    """A stiffness that is a third off and a motion not expected are borne; what is not is flagged, and named lost."""
    stiffness = lambda tree: (tree.start, tree.device.kxx, tree.device.kyy)  # noqa: E731
    for wrong in (0.7, 1.4, 0.3, 3.0):
        moved = tuple(value * wrong + 1e-7 for value in loop.start)
        off = (moved, wrong * loop.device.kxx, wrong * loop.device.kyy)
        path, alive = rows(eqx.tree_at(stiffness, loop, off))
        assert np.all(np.isfinite(path)) or not alive
        assert alive or wrong in (0.3, 3.0)


def end(loop):
    """Motion and estimate after some samples."""

    def sample(state, i):
        clock = Clock(i * 5e-6, i, 5e-6)
        return loop.step(state, as_scenario(0.5).at(clock.time), (0.3, -0.2), clock)[0], None

    state, _ = jax.lax.scan(sample, jax.tree.map(lambda v: jnp.asarray(v, float), loop.init()), jnp.arange(SAMPLES))
    estimate = loop.estimate(state)
    return jnp.stack([*state.motion, *estimate.motion, *estimate.theta])


@pytest.mark.slow
def test_the_gradient_is_finite(loop):
    arrays, static = eqx.partition(loop, eqx.is_inexact_array)

    def value(leaves):
        numbers = end(eqx.combine(leaves, static))
        return jnp.sum((numbers / (1e-12 + jnp.abs(jax.lax.stop_gradient(numbers)))) ** 2)

    slopes = jax.jit(jax.grad(value))(arrays)
    assert all(np.all(np.isfinite(leaf)) for leaf in jax.tree.leaves(slopes))
    part = "observer" if loop.observer.usually_tuned else "controller"
    assert any(np.any(np.asarray(leaf) != 0.0) for leaf in jax.tree.leaves(getattr(slopes, part)))


def test_what_is_usually_tuned_has_bounds_and_an_entry_of_the_file(study, tmp_path):
    for part in ("observer", "controller"):
        named = getattr(study.loop, part).usually_tuned
        if not named:
            continue
        numbers = resolved(study.loop, mg.free(**{part: named}), 200e3, 0.1)
        assert np.all(numbers.low <= numbers.values)
        assert np.all(numbers.values < numbers.high)
        tuned = study.with_numbers(numbers.applied(study.loop, 1.01 * numbers.values), numbers.paths)
        again = mg.load_study(tuned.write(tmp_path / f"{part}.toml"))
        found = resolved(again.loop, mg.free(**{part: named}), 200e3, 0.1).values
        np.testing.assert_allclose(found, 1.01 * numbers.values, rtol=1e-12)
