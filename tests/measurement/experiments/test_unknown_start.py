"""What the unknown starts of pieces take of a residual, and give back."""

import numpy as np
import pytest

from memsgyro_jax.measurement.experiments.unknown_start import put_back


@pytest.mark.parametrize("phasors", [True, False])
def test_what_starts_took_is_noise_again(phasors):
    """Of two channels, in phase with what each does and in quadrature; where nothing was predicted, nothing is new."""
    rng, time = np.random.default_rng(3), np.arange(30)
    phase = 0.9 * time + rng.uniform(0, 6, (2000, 1))
    waves = np.stack([np.exp(1j * phase), 0.3 * np.exp(2j * phase)], axis=-1)
    waves[0] = 0.0
    white = rng.standard_normal((2000, 30, 2, 2 if phasors else 1))
    for k in range(2):
        turned = np.stack([waves[:, :, k], 1j * waves[:, :, k]], axis=-1)
        columns = np.concatenate([turned.real, turned.imag], axis=1) if phasors else turned.real
        basis, _ = np.linalg.qr(columns[1:])
        rows = np.concatenate(np.moveaxis(white[1:, :, k], -1, 0), axis=1)
        rows -= (basis @ (np.swapaxes(basis, 1, 2) @ rows[..., None]))[..., 0]
        white[1:, :, k] = np.moveaxis(rows.reshape(1999, -1, 30), 1, -1)
    every = put_back(white, waves)
    np.testing.assert_array_equal(every[0], white[0])
    shares = [np.mean(one[1:] ** 2, axis=(0, 1, 3)) for one in (white, every)]
    np.testing.assert_allclose(shares[0], 1.0 - 2.0 / white[0, :, 0].size, atol=0.012)
    np.testing.assert_allclose(shares[1], 1.0, atol=0.012)
    back = (every - white)[1:, :, 0]
    along = np.sum((back[..., 0] + 1j * back[..., 1] if phasors else 2 * back[..., 0]) * waves[1:, :, 0].conj(), axis=1)
    assert np.mean(np.abs(along) ** 2) == pytest.approx(2 * 30 if phasors else 4 * 30, rel=0.1)
