"""The loop in blocks: the same figures as sample by sample, and the algebra that leads there."""

from dataclasses import replace
from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats
from sine_response import told_and_seen

import memsgyro_jax as mg
from memsgyro_jax.loop.blocks import basis, reading
from memsgyro_jax.loop.blocks.algebra import multiplied
from memsgyro_jax.loop.blocks.length import Blocks, lengths, renewals
from memsgyro_jax.loop.blocks.run import prepared


GYRO, READOUT = mg.SingleMassGyro.chi2010(), mg.ChargeAmplifier.chi2010()
OBSERVER = mg.ExtendedKalmanFilter.for_device(GYRO, READOUT, annealing=mg.Annealing())
LOOP = mg.ClosedLoop(GYRO, READOUT, OBSERVER, mg.DampingCompensation(tones=mg.Tone(600.0, 53.95)))


def lot(loop: mg.ClosedLoop, dies: int = 32, **settings) -> dict[str, np.ndarray]:
    found = mg.sweep(loop, mg.Spread.relative(0.15), 1.0, dies=dies, bound_dies=0, **settings).data
    return {name: found[name].values for name in ("rate_error_end", "rate_std_end", "nees_end", "nis_mean", "status")}


@pytest.fixture(scope="module")
def samples() -> dict[str, np.ndarray]:
    return lot(LOOP, 128)


def difference(a: dict, b: dict) -> float:
    """Root mean square difference of the errors at the end, in claimed standard deviations."""
    return float(np.sqrt(np.mean(((a["rate_error_end"] - b["rate_error_end"]) / b["rate_std_end"]) ** 2)))


def test_the_same_noise_gives_the_same_rate(samples):
    found = lot(replace(LOOP, blocks=Blocks(512, projected=True)), 128)
    assert difference(found, samples) < 0.01
    np.testing.assert_allclose(found["rate_std_end"], samples["rate_std_end"], rtol=2e-3)
    np.testing.assert_allclose(found["nees_end"], samples["nees_end"], atol=1.0)  # itself ± 5.3


@pytest.mark.slow
def test_a_die_is_the_same_in_any_company():
    many, few = lot(LOOP.in_blocks(), 40), lot(LOOP.in_blocks(), 20)
    for name, values in few.items():
        np.testing.assert_array_equal(many[name][:20], values)
    assert np.all(many["status"] == 0)
    assert abs(np.mean(many["nis_mean"]) - 2.0) < 4.0 * np.sqrt(4.0 / (40 * 10 * 14))


@pytest.mark.slow
def test_slopes_of_a_product_and_of_what_statistics_told():
    """Of a product by its definition; of all statistics forwards and backwards as of the recursion itself, for one and
    for many dies more.
    """
    generator = np.random.default_rng(0)

    def drawn(*shape):
        return jnp.asarray(generator.normal(size=shape))

    @partial(jax.jit, static_argnums=0)
    def along(way, given, moved):
        return jax.jvp(way, (given,), (moved,))[1]

    @partial(jax.jit, static_argnums=0)
    def back(way, given, pull):
        return jax.vjp(way, given)[1](pull)[0]

    def alike(ones, others):
        for one, other in zip(ones, others, strict=True):
            np.testing.assert_allclose(one, other, rtol=1e-9, atol=1e-9)

    def plain(a, b):
        return jnp.einsum("...kl,kabl->...abl", a, b)

    for rows, inner in (((3, 2), 4), ((2,), 34), ((18,), 1)):
        factors, pulled = (drawn(*rows, inner, 5), drawn(inner, 3, 2, 5)), drawn(*rows, 3, 2, 5)
        made, turned = jax.vjp(multiplied, *factors)
        wanted, meant = jax.vjp(plain, *factors)
        alike((made, *turned(pulled)), (wanted, *meant(pulled)))
        twice, sought = (
            jax.vjp(lambda *given, way=way: jax.vjp(way, *given[1:])[1](given[0]), pulled, *factors)[1](factors)
            for way in (multiplied, plain)
        )
        alike(twice, sought)
        changed = jnp.stack([factors[0], 2.0 * factors[0]])
        np.testing.assert_array_equal(jax.vmap(multiplied, (0, None))(changed, factors[1])[1], 2.0 * made)

    def even(matrix):
        return matrix + jnp.swapaxes(matrix, 0, 1)

    root = drawn(4, 4, 2)
    given = reading.Scalars(drawn(6, 4, 2), drawn(6, 2), jnp.exp(drawn(6, 2)), jnp.einsum("ijl,kjl->ikl", root, root))
    moved = reading.Scalars(drawn(6, 4, 2), drawn(6, 2), drawn(6, 2), even(drawn(4, 4, 2)))
    pull = reading.Read(drawn(4, 2), even(drawn(4, 4, 2)), drawn(6, 2), drawn(6, 2))
    ways = reading.read_off, reading.read_off.fun
    alike(*(along(way, given, moved) for way in ways))
    pulled, meant = (back(way, given, pull) for way in ways)
    alike((*pulled[:3], even(pulled.covariance)), (*meant[:3], even(meant.covariance)))
    many = jax.jit(jax.vmap(lambda by: along(ways[0], given, jax.tree.map(lambda part: by * part, moved))))
    alike(*(jax.tree.map(lambda part, i=i: part[i] / (i + 1.0), many(jnp.array([1.0, 2.0]))) for i in range(2)))


@pytest.mark.slow
def test_sobol_in_blocks_is_that_of_samples():
    """At the same points and with the same noise."""
    ways = [
        mg.sobol(loop, mg.Spread.relative(0.15), points=32, duration=0.05)
        for loop in (LOOP, replace(LOOP, blocks=Blocks(512, projected=True)))
    ]
    for name in ("mean", "std"):
        samples, blocks = (getattr(way, name) for way in ways)
        np.testing.assert_allclose(blocks[0], samples[0], rtol=0.05)
    np.testing.assert_allclose(ways[1].total[0], ways[0].total[0], atol=0.1)


@pytest.mark.slow
def test_drawn_statistics_are_those_of_drawn_samples():
    found = lot(LOOP.in_blocks(), 4096)
    normalised = found["rate_error_end"] / found["rate_std_end"]
    assert stats.kstest(normalised, "norm").pvalue > 0.01
    low, high = stats.chi2.ppf([0.005, 0.995], 14 * 4096) / 4096
    assert low < np.mean(found["nees_end"]) < high


@pytest.mark.slow
def test_a_trace_holds_the_ends_of_blocks():
    few = ("kxy", "dxx", "dyy", "dxy", "sigma")  # a smaller filter compiles faster
    observer = mg.ExtendedKalmanFilter.for_device(GYRO, READOUT, annealing=mg.Annealing(), known=few)
    trace = mg.simulate(
        replace(LOOP, observer=observer).in_blocks(), 1.0, sample_rate=100e3, duration=0.1, seed=3, decimation=56
    )
    np.testing.assert_allclose(np.diff(trace.time), [480e-6] * 10 + [2.56e-3] + [5.12e-3] * 18)
    assert trace.time[-1] == pytest.approx(0.1)
    assert trace.lost_at is None
    assert abs(trace.rate_error[-1]) < 4.0 * trace.rate_std[-1]
    assert trace.rate_response(10.0) == 0.0, "a filter that holds the rate constant follows no sine"


@pytest.mark.slow
def test_a_run_too_short_for_a_block_goes_by_samples():
    """And one with a single block in its settled part has no scatter to tell."""
    few = ("kxy", "dxx", "dyy", "dxy", "sigma")
    loop = replace(LOOP, observer=mg.ExtendedKalmanFilter.for_device(GYRO, READOUT, known=few))
    run = {"sample_rate": 100e3, "duration": 2e-3}
    np.testing.assert_array_equal(
        mg.simulate(loop.in_blocks(), 1.0, **run).rate_estimate, mg.simulate(loop, 1.0, **run).rate_estimate
    )
    lots = {"spread": mg.Spread.relative(0.01), "dies": 2, "sample_rate": 100e3, "bound_dies": 0}
    short = mg.sweep(loop.in_blocks(), duration=2e-3, **lots)
    np.testing.assert_array_equal(
        short.data["rate_error_end"], mg.sweep(loop, duration=2e-3, **lots).data["rate_error_end"]
    )
    single = mg.sweep(loop.in_blocks(), duration=0.018, **lots)
    assert np.isnan(single.data["rate_series_std"]).all()
    assert "unknown (the settled part holds one estimate)" in str(single)


@pytest.mark.slow
@pytest.mark.parametrize("blocks", [None, Blocks(512), Blocks(2048)], ids=["samples", "512", "2048"])
def test_a_trace_tells_how_the_rate_is_followed(blocks):
    """What a sine adds to the estimate, beside the same noise without it."""
    known, noise = ("kxy", "dxx", "dyy", "dxy", "sigma"), mg.ProcessNoise.of(GYRO.model, rate=100.0)
    observer = mg.ExtendedKalmanFilter.for_device(
        GYRO, READOUT, annealing=mg.Annealing(), known=known, process_noise=noise
    )
    loop = replace(LOOP, observer=observer, blocks=blocks)
    for frequency in (1.0, 10.0, 30.0):
        told, seen = told_and_seen(loop, frequency)
        assert abs(told) == pytest.approx(abs(seen), abs=0.02)
        lag = np.angle(told / seen) / (2.0 * np.pi * frequency)
        assert abs(lag) < 0.5e-3, "of 2.5 to 10.9 ms"


@pytest.mark.parametrize(
    ("part", "words"),
    [
        (lambda loop: loop.device, "effect cubic_stiffness x"),
        (lambda loop: loop.readout, "converter"),
        (lambda loop: loop.observer, "fading memory"),
        (lambda loop: loop.controller, "Own is no AbstractLinearController"),
    ],
)
def test_the_part_that_holds_a_loop_up_is_told(part, words):
    class Own(mg.AbstractController):
        def init(self):
            return ()

        def command(self, state, estimate, clock):
            return (0.0, 0.0), state

    others = mg.ClosedLoop(
        GYRO.with_effect(mg.effects.CubicStiffness("x", 1e12)),
        eqx.tree_at(lambda r: r.adc, READOUT, mg.Adc(5.0, 16), is_leaf=lambda leaf: leaf is None),
        mg.ExtendedKalmanFilter.for_device(GYRO, READOUT, fading=mg.FixedFading(100.0)),
        Own(),
    )
    mixed = eqx.tree_at(part, LOOP.in_blocks(), part(others))
    plain, said = prepared(mixed)
    assert plain.blocks is None
    assert len(said) == 1
    assert words in said[0]


class Doubled(mg.DirectReadout):
    def measure(self, motion, noise, drift, period, effects=None, late=None):
        return super().measure(motion, tuple(2.0 * n for n in noise), drift, period, effects, late)


class Clipped(mg.ExtendedKalmanFilter):
    def update(self, state, measured, force, clock):
        return super().update(state, tuple(jnp.clip(volts, -1.0, 1.0) for volts in measured), force, clock)


class Bounded(mg.DampingCompensation):
    def command(self, state, estimate, clock):
        force, state = super().command(state, estimate, clock)
        return tuple(1e-7 * jnp.tanh(f / 1e-7) for f in force), state


class Stepped(mg.Exact):
    def advance(self, motion, push, stiffness, velocity, period):
        return super().advance(motion, push, stiffness, velocity, period)


class Plain(mg.DirectReadout):
    def noise_std(self, period):  # which blocks ask
        return tuple(2.0 * std for std in super().noise_std(period))


@pytest.mark.parametrize(
    ("place", "part", "words"),
    [
        ("readout", Doubled(-1e5, noise_density=1e-7), "Doubled has its own `measure`"),
        ("observer", Clipped.for_device(GYRO, READOUT), "Clipped has its own `update`"),
        ("controller", Bounded(), "Bounded has its own `command`"),
        ("discretisation", Stepped(), "Stepped has its own `advance`"),
        ("readout", Plain(-1e5, noise_density=1e-7), None),
    ],
)
def test_what_is_overridden_holds_a_loop_up(place, part, words):
    """Blocks went over it, with the statistics of the class below."""
    parts = {"device": GYRO, "readout": READOUT, "observer": LOOP.observer, "controller": LOOP.controller}
    made, said = prepared(mg.ClosedLoop(**{**parts, place: part}).in_blocks())
    assert (made.blocks is None) == (words is not None)
    if words:
        assert words in said[0]


def test_what_walks_is_told_to_be_later():
    walking = mg.ExtendedKalmanFilter.for_device(
        GYRO, READOUT, process_noise=mg.ProcessNoise.of(GYRO.model, rate=1.0, kxy=0.0)
    )
    made, said = prepared(replace(LOOP, observer=walking).in_blocks(256))
    assert made.blocks.length == 256
    assert len(said) == 1
    assert "(rate)" in said[0]
    assert "128 samples later" in said[0]


DUAL = mg.DualMassGyro.chi2010()
TWO_MASSES = mg.ClosedLoop(DUAL, READOUT, mg.ExtendedKalmanFilter.for_device(DUAL, READOUT), LOOP.controller)


def test_two_masses_start_later():
    made, said = prepared(TWO_MASSES.in_blocks())
    assert said == ()
    assert made.blocks.start == 2048
    assert prepared(LOOP.in_blocks())[0].blocks.start == 512
    assert prepared(TWO_MASSES.in_blocks(start=600))[0].blocks.start == 600


@pytest.mark.slow
def test_the_same_noise_gives_the_same_rate_where_modes_lie_side_by_side(tmp_path):
    """Two modes 15 Hz apart at 9.8 kHz, started and sampled as a file with the device alone has it; after 512 samples
    one by one 2 %.
    """
    (tmp_path / "study.toml").write_text(
        '[device]\nkind = "single_mass"\nmass = "1.1e-7 kg"\n'
        'frequency = ["9.81 kHz", "9.825 kHz"]\nquality_factor = 2150\n'
    )
    given = dict(mg.load_study(tmp_path / "study.toml").changed({"sweep.dies": 64}).sweep_arguments)
    loop = given.pop("loop")
    assert prepared(loop.in_blocks())[0].blocks.start == 1024
    run = {**given, "bound_dies": 0}
    plain, found = (mg.sweep(made, **run).data for made in (loop, replace(loop, blocks=Blocks(512, projected=True))))
    assert difference(found, plain) < 0.01


@pytest.mark.slow
def test_the_same_noise_gives_the_same_rate_of_two_masses():
    observer = mg.ExtendedKalmanFilter.for_device(DUAL, READOUT, annealing=mg.Annealing())
    loop = replace(TWO_MASSES, observer=observer)
    plain, found = lot(loop), lot(replace(loop, blocks=Blocks(512, projected=True)))
    assert difference(found, plain) < 0.01
    np.testing.assert_allclose(found["rate_std_end"], plain["rate_std_end"], rtol=2e-3)


# The force that holds 1 µm on each mode against its damping.
ON_BOTH_MODES = mg.OpenLoop((mg.Tone(2893.0, 6.8e-8), mg.Tone(3758.8, 1.04e-7)))


def test_tones_on_modes_ask_for_ramps():
    for controller, ramps in ((ON_BOTH_MODES, True), (LOOP.controller, False), (mg.OpenLoop(), False)):
        assert prepared(replace(LOOP, controller=controller).in_blocks())[0].blocks.ramps is ramps


@pytest.mark.slow
def test_the_same_noise_gives_the_same_rate_under_tones_on_both_modes():
    loop = replace(LOOP, controller=ON_BOTH_MODES)
    found = lot(replace(loop, blocks=Blocks(512, projected=True)))
    assert difference(found, lot(loop)) < 0.005  # 0.011 without the ramps


@pytest.mark.slow
@pytest.mark.parametrize(
    "loop", [LOOP, TWO_MASSES, replace(LOOP, controller=ON_BOTH_MODES)], ids=["one", "two", "tones"]
)
def test_the_bound_by_blocks_is_that_of_samples(loop):
    settings = {"duration": 0.32, "prior": loop.observer.prior, "known": loop.observer.known}
    plain = mg.information_bound(loop, 1.0, windows=1, **settings)
    found, last = (mg.information_bound(loop.in_blocks(), 1.0, windows=windows, **settings) for windows in (8, 1))
    assert (found.time.shape, found.time[-1]) == ((8,), pytest.approx(0.32))
    np.testing.assert_allclose(last.std[-1], found.std[-1], rtol=1e-9)
    np.testing.assert_allclose(last.rate_std, plain.rate_std, rtol=2e-3)
    np.testing.assert_allclose(last.std, plain.std, rtol=2e-2)


def test_a_length_is_a_power_of_two():
    with pytest.raises(mg.InputError, match="power of two, but 500"):
        LOOP.in_blocks(500)
    with pytest.raises(mg.InputError, match="at least 1"):
        LOOP.in_blocks(start=0)


@pytest.mark.parametrize("samples", [100, 512, 10_000, 100_000, 12_345])
def test_what_is_left_of_a_run_is_whole_blocks(samples):
    for stride in (1, 3):
        alone, lead = Blocks(512).first(samples, stride)
        whole, rest = divmod(samples - alone - lead, 512 * stride)
        assert (rest, min(512, samples) <= alone <= min(640, samples)) == (0, True)
        sizes = lengths(alone, lead, 512, stride, whole)
        assert sizes.shape == (len(sizes), stride)
        assert alone + sizes.sum() == samples
        flat = sizes[sizes > 0]
        passed = alone + np.cumsum(flat) - flat
        assert np.all((flat <= passed // 2) | (passed >= alone + lead))


def test_maps_are_made_when_time_has_doubled():
    sizes = np.array([[128, 256, 0], *[[512] * 3] * 16])
    found = renewals(sizes, 2.0)
    assert np.flatnonzero(found).tolist() == [0, 1, 3, 4, 5, 7, 11, 19, 35]
    assert renewals(sizes, 1.0).sum() == 50


def test_the_statistics_of_white_noise_are_white():
    angles = jnp.asarray([[0.2, 0.2], [0.21, 0.2], [0.04, 0.04]])  # of the second die two are one
    number = np.arange(1, 65)
    functions = np.stack([np.asarray(basis.at(n * angles)) for n in number])
    gram = np.einsum("nil,njl->ijl", functions, functions)
    one = basis.at(angles)
    doubled, turn = one[:, None] * one[None], basis.Turn(jnp.cos(angles), jnp.sin(angles))
    for _ in range(6):
        doubled, turn = basis.gram_twice(doubled, turn), turn.twice
    np.testing.assert_allclose(doubled, gram, rtol=1e-10, atol=1e-10)
    whiten = np.asarray(basis.whitening(jnp.asarray(gram)))
    kept = np.einsum("ikl,kml,jml->ijl", whiten, gram, whiten)
    np.testing.assert_allclose(kept[..., 0], np.eye(7), atol=1e-6)
    np.testing.assert_allclose(kept[..., 1], np.diag([1, 1, 0, 1, 1, 0, 1]), atol=1e-6)
