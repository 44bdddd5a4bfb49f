"""The generator is Threefry bit for bit, its numbers are normal, and an address gives the same number in any batch."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from oracles.threefry import threefry
from scipy import stats
from scipy.special import ndtri

from memsgyro_jax.loop import noise


WORD = st.integers(0, 2**32 - 1)
DIES, SAMPLES = 64, 4096


@pytest.fixture(scope="module")
def drawn():
    """Standard normals as (channel, die, sample, stream)."""
    words = noise.die_words(jax.random.key(7), jnp.arange(DIES))
    keys = tuple(word[:, None] for word in words)
    samples = jnp.arange(SAMPLES)[None, :]
    draw = jax.jit(noise.normal_pair, static_argnums=2)
    return np.stack([np.stack(draw(keys, samples, stream)) for stream in (0, 1)], axis=-1)


# Random123's own known answers (kat_vectors, threefry 2 32 20): key words, counter words, output words.
@pytest.mark.parametrize(
    ("key", "counter", "answer"),
    [
        ((0, 0), (0, 0), (0x6B200159, 0x99BA4EFE)),
        ((0xFFFFFFFF, 0xFFFFFFFF), (0xFFFFFFFF, 0xFFFFFFFF), (0x1CB996FC, 0xBB002BE7)),
        ((0x13198A2E, 0x03707344), (0x243F6A88, 0x85A308D3), (0xC4923A9C, 0x483DF7A0)),
    ],
)
def test_known_answers(key, counter, answer):
    words = [tuple(map(jnp.uint32, pair)) for pair in (key, counter)]
    assert tuple(map(int, noise.threefry2x32(*words))) == answer
    assert threefry(key, counter) == answer


@given(WORD, WORD, WORD, WORD)
def test_equals_the_plain_generator(k0, k1, c0, c1):
    words = [tuple(map(jnp.uint32, pair)) for pair in ((k0, k1), (c0, c1))]
    assert tuple(map(int, noise.threefry2x32(*words))) == threefry((k0, k1), (c0, c1))


def test_equals_the_generator_of_jax():
    from jax.extend.random import threefry_2x32

    key = jnp.array([123, 456], jnp.uint32)
    counters = jnp.arange(2000, dtype=jnp.uint32)
    ours = noise.threefry2x32((key[0], key[1]), (counters[:1000], counters[1000:]))
    assert np.array_equal(np.concatenate(ours), np.asarray(threefry_2x32(key, counters)))


def test_words_of_a_die_do_not_depend_on_the_batch():
    key = jax.random.key(3)
    alone = noise.die_words(key, jnp.asarray(17))
    many = noise.die_words(key, jnp.arange(100))
    grid = noise.die_words(key, jnp.arange(100).reshape(20, 5))
    folded = jax.random.key_data(jax.random.fold_in(key, 17))
    for word in (0, 1):
        assert alone[word].shape == ()
        assert alone[word] == many[word][17] == grid[word][3, 2] == folded[word]


def test_words_differ_between_dies_and_seeds():
    words = [noise.die_words(jax.random.key(seed), jnp.arange(1000)) for seed in range(3)]
    pairs = {(int(a), int(b)) for first, second in words for a, b in zip(first, second, strict=True)}
    assert len(pairs) == 3000


def test_a_draw_does_not_depend_on_the_batch(drawn):
    words = noise.die_words(jax.random.key(7), jnp.asarray(41))
    alone = noise.normal_pair(words, jnp.asarray(1234), 1)
    assert [float(a) for a in alone] == drawn[:, 41, 1234, 1].tolist()


def test_a_draw_is_the_inverse_normal_of_its_bits(drawn):
    """To single precision: the sign bit, and the other 31 bits as a probability."""
    words = noise.die_words(jax.random.key(7), jnp.asarray(5))
    bits = np.array([threefry((int(words[0]), int(words[1])), (sample, 0)) for sample in range(500)])
    size = ndtri(0.5 + 0.5 * (bits >> 1) / 2.0**31)
    expected = np.where(bits & 1, -size, size).T
    assert np.allclose(drawn[:, 5, :500, 0], expected, rtol=3e-6, atol=3e-7)


def test_numbers_are_finite_at_the_ends_of_the_range():
    bits = jnp.array([0, 1, 2, 2**32 - 2, 2**32 - 1], jnp.uint32)
    values = np.asarray(noise._normal(bits))
    assert np.all(np.isfinite(values))
    assert np.max(np.abs(values)) == pytest.approx(5.4, abs=0.1)
    assert values[3] == -values[4]
    assert values.dtype == np.float64


def test_numbers_are_standard_normal(drawn):
    """Moments within 5 standard errors, and a Kolmogorov-Smirnov test over a million numbers."""
    x, n = drawn.ravel(), drawn.size
    assert abs(x.mean()) < 5 / n**0.5
    assert abs(x.var() - 1) < 5 * (2 / n) ** 0.5
    assert abs((x**3).mean()) < 5 * (15 / n) ** 0.5
    assert abs((x**4).mean() - 3) < 5 * (96 / n) ** 0.5
    assert stats.kstest(x, "norm").pvalue > 1e-3


def test_the_tails_are_there(drawn):
    """Single precision must not thin out the tails: counts beyond 3 and 4 sigma are Poisson."""
    for level in (3.0, 4.0):
        expected = 2 * stats.norm.sf(level) * drawn.size
        assert abs(np.sum(np.abs(drawn) > level) - expected) < 5 * expected**0.5


def test_channels_dies_samples_and_streams_are_independent(drawn):
    """Sample correlations of everything that shares part of its address stay within 5 standard errors."""
    x, y = drawn

    def correlation(a, b):
        return abs(np.mean(a * b)) * np.size(a) ** 0.5

    assert correlation(x, y) < 5
    assert correlation(x[..., 0], x[..., 1]) < 5
    assert correlation(x[..., 0], y[..., 1]) < 5
    for lag in (1, 2, 3, 64):
        assert correlation(x[:, :-lag], x[:, lag:]) < 5
        assert correlation(x[:-lag], x[lag:]) < 5 if lag < DIES else True
        assert correlation(x[:, :-lag], y[:, lag:]) < 5
    between = np.corrcoef(x[..., 0]) - np.eye(DIES)
    assert np.max(np.abs(between)) < 5.5 / SAMPLES**0.5
    assert correlation(x**2 - 1, y**2 - 1) < 5 * 2
