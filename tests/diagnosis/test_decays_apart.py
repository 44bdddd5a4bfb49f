"""A ring-down on another clock than the sweeps beside it: no law of the device, and said so."""

import re

import numpy as np

import memsgyro_jax as mg
from memsgyro_jax.diagnosis.decays_apart import decays_apart


F0, Q, NOISE, OFF = 14e3, 1e4, 1e-5, 8e-6


def files(folder, off, noise):
    rng = np.random.default_rng(3)
    hertz = F0 * (1 + off) + np.linspace(-4.0, 4.0, 81)
    for level in (50, 200):
        seen = 1e-4 * level / (1 - (hertz / F0 / (1 + off)) ** 2 + 1j * hertz / F0 / Q) / Q * 100
        seen = seen + NOISE * (rng.standard_normal(81) + 1j * rng.standard_normal(81))
        rows = [f"{f!r},{z.real!r},{z.imag!r}" for f, z in zip(hertz.tolist(), seen.tolist(), strict=True)]
        (folder / f"sweep_{level}mV.csv").write_text("\n".join(["f [Hz],Vx_I [V],Vx_Q [V]", *rows]))
    time = 0.002 * np.arange(400)
    rung = 0.7 * np.exp(-np.pi * F0 / Q * time + 0.4j)
    rung = rung + noise * (rng.standard_normal(400) + 1j * rng.standard_normal(400))
    rows = [f"{t!r},{z.real!r},{z.imag!r}" for t, z in zip(time.tolist(), rung.tolist(), strict=True)]
    (folder / "ring.csv").write_text("\n".join(["t [s],Vx_I [V],Vx_Q [V]", *rows]))
    names = [folder / name for name in ("sweep_50mV.csv", "sweep_200mV.csv", "ring.csv")]
    return mg.import_case(names, folder / "case", reference="14 kHz").case


def test_the_clocks_are_told_apart(tmp_path):
    said = decays_apart(mg.compare(None, files(tmp_path, OFF, NOISE)).fit)
    told = re.search(r"ring with a resonance ([\d.]+) ± ([\d.]+) ppm lower and the same quality factor", said)
    assert told, said
    damped = 1e6 / (8 * Q**2)  # a decay rings so much lower than its resonance
    assert abs(float(told[1]) - 1e6 * OFF / (1 + OFF) + damped) < 4 * float(told[2])
    assert "another clock" in said


def test_one_clock_is_not(tmp_path):
    assert decays_apart(mg.compare(None, files(tmp_path, 0.0, NOISE)).fit) == ""
