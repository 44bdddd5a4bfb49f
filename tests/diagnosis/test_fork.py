"""A tuning fork as a test engineer records it: three drives up and down, a reference that turns, a latency, decimal
commas, and rows that are wrong. Simulated here by the balance of one harmonic, with nothing of the package.
"""

import numpy as np
import pytest

import memsgyro_jax as mg
from memsgyro_jax.app import cli


HERTZ, QUALITY, KAPPA, GAIN = 32768.413, 9000.0, 6e-4, 1 / 900.0  # κ: of the squared reading, in 1/V²
PHASE, LATENCY, NOISE = 0.35, 1.2e-6, 1.5e-3
LEVELS = (20, 60, 150)  # mV


def response(hertz, force, before):
    """The amplitude nearest to that of the row before, and its phasor, of (1 − r² + ¾κa² + ir/Q)·a = F."""
    ratio = hertz / HERTZ
    bent, stiff = 0.75 * KAPPA, 1.0 - ratio**2
    square = np.roots([bent**2, 2.0 * bent * stiff, stiff**2 + (ratio / QUALITY) ** 2, -(force**2)])
    square = square.real[(np.abs(square.imag) < 1e-7 * np.abs(square)) & (square.real > 0.0)]
    amplitude = np.sqrt(square)
    amplitude = amplitude[np.argmin(np.abs(amplitude - before))]
    return amplitude, 1j * ratio * force / (stiff + bent * amplitude**2 + 1j * ratio / QUALITY)


def recorded(folder):
    """The files, and by name which rows are wrong."""
    rng, wrong = np.random.default_rng(20261126), {}
    for level in LEVELS:
        for way, step in (("up", 1), ("down", -1)):
            hertz, amplitude, seen = np.linspace(32756.0, 32788.0, 129)[::step], 0.0, []
            for one in hertz:
                amplitude, phasor = response(one, GAIN * 1e-3 * level, amplitude)
                seen.append(phasor)
            read = np.array(seen) * np.exp(-1j * (PHASE + 2 * np.pi * hertz * LATENCY))
            read = read + NOISE * (rng.standard_normal(hertz.size) + 1j * rng.standard_normal(hertz.size))
            bad = rng.random(hertz.size) < 0.01
            turn, size = rng.random(bad.sum()), rng.uniform(0.5, 2.0, bad.sum())
            read[bad] += 40.0 * NOISE * size * np.exp(2j * np.pi * turn)
            rows = [f"{f:.3f};{z.real:.7e};{z.imag:.7e}".replace(".", ",") for f, z in zip(hertz, read, strict=True)]
            file = folder / f"fork_{level}mV_{way}.csv"
            file.write_text("\n".join(["Frequency (Hz);X (V);Y (V)", *rows]) + "\n")
            wrong[file.stem] = set(np.flatnonzero(bad).tolist())
    return wrong


@pytest.mark.slow
def test_a_fork_is_told_from_its_files(tmp_path):
    wrong = recorded(tmp_path)
    files = [str(tmp_path / f"fork_{level}mV_{way}.csv") for level in LEVELS for way in ("up", "down")]
    with pytest.raises(SystemExit) as end:
        cli.main(["import", *files, "--out", str(tmp_path / "case")])
    assert end.value.code == 0
    found = mg.diagnose(None, mg.load_case(tmp_path / "case"))
    assert found.verdict == "found"
    assert [a.name for a in found.accepted] == ["cubic_stiffness"]
    hertz, quality = found.modes
    assert abs(hertz.value - HERTZ) < 4 * hertz.std < 0.02
    assert abs(quality.value - QUALITY) < 4 * quality.std < 40.0
    model = found.model
    spring = next(e for e in model.effects if e.name == "cubic_stiffness")
    device, omega2 = model.device, float(model.device.stiffness[0])
    kappa = float(spring.strength * device.mobility) / omega2 / (float(model.scale[0]) ** 2 * omega2)
    assert kappa == pytest.approx(KAPPA, rel=3e-3)
    assert {name: set(rows) for name, rows in found.outlying.items()} == {n: rows for n, rows in wrong.items() if rows}
