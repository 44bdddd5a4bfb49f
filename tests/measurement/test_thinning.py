"""A long ringing of a lock-in's phasors becomes means of its rows, which say as much in less time."""

import numpy as np
import pytest

import memsgyro_jax as mg


RATE, NOISE = 13.39e3, 1e-4


def ringing(path, seed, rows=24_800, lone=0, decay=6.5, beat=-0.3):
    """Phasors of 62 kHz, Q 3e4, beside a reference near it; returns the true ones over time."""
    rng = np.random.default_rng(seed)
    time = np.arange(rows) / RATE
    noisy = rung(time, decay, beat) + NOISE * (rng.standard_normal(rows) + 1j * rng.standard_normal(rows))
    noisy[rng.choice(rows, lone, replace=False)] += 0.05
    lines = [
        "timestamp (s);x (V);y (V)",
        *(f"{t:.9f};{z.real:.9e};{z.imag:.9e}" for t, z in zip(time, noisy, strict=True)),
    ]
    path.write_text("\n".join(lines) + "\n")
    return path


def rung(time, decay, beat):
    return 0.4 * np.exp(-decay * time + 1j * (2 * np.pi * beat * time + 0.3))


@pytest.mark.parametrize(("decay", "beat", "lone"), [(6.5, -0.3, 0), (6.5, 150.0, 40), (40.0, 5.0, 7)])
def test_means_lie_on_the_curve_with_the_noise_of_a_mean(decay, beat, lone, tmp_path):
    left = []
    for seed in range(2):
        path = ringing(tmp_path / f"ring_{seed}.csv", seed, lone=lone, decay=decay, beat=beat)
        made = mg.import_case([path], tmp_path / f"case_{seed}", reference="62 kHz")
        (record,) = made.case.records
        every = round(record.period * RATE)
        assert 2000 <= record.rows < 13_000
        assert f"each row is the mean of {every}" in str(made)
        assert ("stand alone" in str(made)) == (lone > 0)
        if lone:
            assert f"of which {lone} readings that stand alone are left out" in str(made)
        off = (record.signals[:, 0] - rung(record.time, decay, beat)) / NOISE * np.sqrt(every)
        left += [off.real, off.imag]
    white = np.concatenate(left)
    assert np.mean(white**2) == pytest.approx(1.0, abs=4 * np.sqrt(2 / white.size))


def test_what_is_short_or_asked_for_stays(tmp_path):
    short = ringing(tmp_path / "short.csv", 0, rows=3900)
    assert mg.import_case([short], tmp_path / "a", reference="62 kHz").case.records[0].rows == 3900
    long = ringing(tmp_path / "long.csv", 0)
    assert mg.import_case([long], tmp_path / "b", reference="62 kHz", every=1).case.records[0].rows == 24_800
    fewer = mg.import_case([long], tmp_path / "c", reference="62 kHz", every=4)
    assert fewer.case.records[0].rows == 6200
    assert "each row is the mean of 4" in str(fewer)
