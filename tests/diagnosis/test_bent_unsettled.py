"""Whole diagnoses of a bent resonance whose rows were read before it had settled, from the records as they lie."""

import numpy as np
import pytest

import memsgyro_jax as mg


NOISE = 3e-4
BESIDE = 4.0  # standard deviations that an estimate may lie from the truth


def swept(path, f0, quality, bend, decays, tau=0.0, poles=0, seed=0):
    """Two drives, up and down, of a resonance that moves by `bend` of its width at 1 V: its amplitude's equation of
    motion and the poles of a filter behind it, by Runge and Kutta. A row lasts so many decay times.
    """
    w0, decay, rng = 2 * np.pi * f0, np.pi * f0 / quality, np.random.default_rng(seed)
    spring, at, time, rows = 4 * np.pi * w0 * bend * f0 / quality, np.zeros(poles + 1, complex), 0.0, []

    def slope(at, omega, drive):
        own = w0**2 - omega**2 + 2j * decay * omega + spring * abs(at[0]) ** 2
        out = np.empty_like(at)
        out[0] = (2 * decay * w0 * drive - own * at[0]) / (2j * omega + 2 * decay)
        out[1:] = (at[:-1] - at[1:]) / (tau or 1.0)
        return out

    for drive in (0.5, 1.0):
        for way in (1, -1):
            for n, f in enumerate(f0 + np.linspace(-4.0, 4.0, 81)[::way] * f0 / quality):
                dwell = (decays if n else 30.0) / decay
                count = int(np.ceil(dwell * max((2 * np.pi * abs(f - f0) + 4 * decay) / 0.2, 10.0 / (tau or 1e3))))
                h, known = dwell / count, (2 * np.pi * f, drive)
                for _ in range(count):
                    a = slope(at, *known)
                    b = slope(at + h / 2 * a, *known)
                    c = slope(at + h / 2 * b, *known)
                    at = at + h / 6 * (a + 2 * b + 2 * c + slope(at + h * c, *known))
                time += dwell
                seen = at[-1] + NOISE * (rng.normal() + 1j * rng.normal())
                rows.append((time, drive, f, seen.real, seen.imag))
    head = "t [s],drive [V],f [Hz],X [V],Y [V]"
    np.savetxt(path, rows, "%.12g", ",", header=head, comments="")
    return 8 / 3 * bend  # the spring, in V/V³ of a drive that makes as many V of the linear device at its resonance


def found_in(tmp_path, *device, **poles):
    truth = swept(tmp_path / "s.csv", *device, **poles)
    mg.import_case([tmp_path / "s.csv"], tmp_path / "case")
    return truth, mg.diagnose(None, mg.load_case(tmp_path / "case"))


@pytest.mark.slow
@pytest.mark.parametrize("bend", [0.2, 0.6, 1.0])
def test_a_spring_is_found_in_rows_that_had_not_settled(tmp_path, bend):
    """It was 25 times the noise and an unknown effect."""
    truth, found = found_in(tmp_path, 5e3, 2000.0, bend, 2.5)
    assert (found.verdict, [one.label for one in found.accepted]) == ("found", ["cubic_stiffness x"])
    spring = found.accepted[0]
    assert 0.9 < spring.error_after < 1.1
    assert abs(spring.estimate[0] - truth) < BESIDE * spring.std[0]


@pytest.mark.slow
def test_a_linear_device_has_none(tmp_path):
    assert found_in(tmp_path, 32e3, 20000.0, 0.0, 2.5)[1].verdict == "nothing_missing"


@pytest.mark.slow
def test_a_filter_is_the_instruments_and_the_spring_the_devices(tmp_path):
    decay = np.pi * 30e3 / 3000
    truth, found = found_in(tmp_path, 30e3, 3000.0, 0.6, 3.0, tau=0.9 / decay, poles=3)
    assert (found.verdict, [one.label for one in found.accepted]) == ("found", ["cubic_stiffness x"])
    assert [(term.label, term.numbers["poles"][0]) for term in found.instrument] == [("lock_in_filter", 3.0)]
    assert abs(found.accepted[0].estimate[0] - truth) < BESIDE * found.accepted[0].std[0]
