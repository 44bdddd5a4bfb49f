"""Noise of another size than declared, and what repeats from sweep to sweep, which is none."""

from types import SimpleNamespace

import numpy as np
import pytest
from bench_case import ONE_AXIS, RESONATOR, bench
from lab.die import Hidden, Outside

from memsgyro_jax.diagnosis import wrong_noise as room
from memsgyro_jax.diagnosis.diagnose import diagnose
from memsgyro_jax.diagnosis.fit import fit_case
from memsgyro_jax.diagnosis.sentence import of_noise
from memsgyro_jax.diagnosis.wrong_noise import what_repeats, wrong_noise
from memsgyro_jax.measurement.case import load_case
from memsgyro_jax.measurement.experiments.deviation import Series


F0, Q, NOISE = 13999.74, 1e4, 9e-4
CASE = """schema = "memsgyro-case/1"
name = "few"
device = "resonator"
[readout]
quantity = "displacement"
"""
RECORD = """[[experiment]]
name = "at_{level}mV"
kind = "frequency_sweep"
file = "at_{level}mV.csv"
settled = true
noise_std = {{ value = 0.3, unit = "mV" }}
drive_force = {{ value = {level}, unit = "mV" }}
drive_axis = "x"
"""


def few_rows(folder, digits, seed=0):
    """Sweeps of twelve rows at three levels, of a linear device; noise three times what is declared."""
    levels, rng = (20, 60, 150), np.random.default_rng(seed)
    (folder / "case.toml").write_text(CASE + "".join(RECORD.format(level=level) for level in levels))
    hertz = np.linspace(13996.0, 14004.0, 12)
    for level in levels:
        seen = 12.2e-7 * level / (1 - (hertz / F0) ** 2 + 1j * hertz / F0 / Q)
        seen = seen + NOISE * (rng.standard_normal(12) + 1j * rng.standard_normal(12))
        rows = [f"{f:.{digits}f},{v.real!r},{v.imag!r}" for f, v in zip(hertz, seen.tolist(), strict=True)]
        (folder / f"at_{level}mV.csv").write_text("\n".join(["f [Hz],Vx_I [V],Vx_Q [V]", *rows]))
    return load_case(folder)


@pytest.mark.parametrize(("digits", "words"), [(2, "rounded to 10 mHz"), (8, "")])
def test_what_rounded_frequencies_leave_repeats_and_is_no_noise(tmp_path, digits, words):
    fit = fit_case(few_rows(tmp_path, digits))
    noise = wrong_noise(fit)
    assert noise
    again = what_repeats(fit, noise)
    assert words in again
    assert bool(again) == bool(words)
    said = of_noise(noise, set(noise), again)
    assert ("depends on nothing" in said) != bool(words)
    assert ("repeats from sweep to sweep" in said) == bool(words)


@pytest.mark.parametrize("weak", [0.3, 0.6])
def test_an_internal_resonance_that_shows_in_a_few_rows_is_no_noise(weak):
    """Between coarse rows it looks white, and is twenty times the noise."""
    strange = Hidden(outside=Outside(internal_x=weak * RESONATOR.kxx, internal_ratio=2.001))
    found = diagnose(None, bench(strange, protocol=ONE_AXIS, die=RESONATOR).case)
    assert found.verdict == "unknown_effect"
    assert "no effect is missing" not in found.sentence


@pytest.mark.parametrize(
    ("times", "words", "noise"), [(9.0, "", True), (9.0, room._OFF, False), (2.0, room._OFF, True)]
)
def test_what_is_large_and_repeats_is_no_noise(monkeypatch, times, words, noise):
    white = times * np.random.default_rng(3).standard_normal((400, 2))
    one = _series(white)
    checks = iter([SimpleNamespace(record="sweep", failed=True)] * 2)
    monkeypatch.setattr(room, "judged", lambda fit: SimpleNamespace(series=[one], checks=[next(checks)], level=0.05))
    monkeypatch.setattr(room, "check_all", lambda series, level: [])
    monkeypatch.setattr(room, "what_repeats", lambda fit, found: words)
    found = wrong_noise(SimpleNamespace(deviations=()))
    assert bool(found) == noise
    if noise:
        assert found["sweep"] == pytest.approx(times, rel=0.1)


@pytest.mark.parametrize(("few", "noise"), [(0, True), (12, False)])
def test_a_misfit_of_a_few_rows_is_no_noise_of_another_size(monkeypatch, few, noise):
    white = 4.0 * np.random.default_rng(4).standard_normal((400, 2))
    white[:few] *= 20.0
    one = _series(white)
    failed = [SimpleNamespace(record="sweep", failed=True)]
    monkeypatch.setattr(room, "judged", lambda fit: SimpleNamespace(series=[one], checks=failed, level=0.05))
    monkeypatch.setattr(room, "check_all", lambda series, level: [])
    monkeypatch.setattr(room, "what_repeats", lambda fit, found: "")
    assert bool(wrong_noise(SimpleNamespace(deviations=()))) == noise


def _series(white):
    return Series("sweep", ("x",), white, white, (slice(None),), (), (), ())
