"""A sweep that is predicted without a record: exact where linear, on the right branch where it is bent."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import memsgyro_jax as mg


HERTZ, QUALITY, MASS = 11.3e3, 900.0, 4e-9  # of a resonator that nobody made
STIFFNESS = MASS * (2.0 * np.pi * HERTZ) ** 2
FORK = mg.Resonator(2.0 * np.pi * HERTZ, QUALITY, 1.0 / STIFFNESS)
GYRO = mg.SingleMassGyro.from_modes("30 ug", ("7.2 kHz", "7.35 kHz"), (800, 1200), quadrature="40 deg/s")


def branches(hertz: float, force: float, cubic: float) -> np.ndarray:
    """Amplitudes that a Duffing oscillator may settle at, by its cubic equation for the fundamental alone."""
    omega, own = 2.0 * np.pi * hertz, 2.0 * np.pi * HERTZ
    detuned, bend, width = own**2 - omega**2, 0.75 * cubic / MASS, omega * own / QUALITY
    roots = np.roots([bend**2, 2.0 * detuned * bend, detuned**2 + width**2, -((force / MASS) ** 2)])
    real = roots.real[np.abs(roots.imag) < 1e-9 * np.abs(roots.real)]
    return np.sort(np.sqrt(real[real > 0.0]))


@pytest.mark.slow
def test_linear_modes_are_exact():
    """Those of the closed form, also turning, and of the other electrode."""
    hertz = np.linspace(7.15e3, 7.4e3, 11)
    modes = mg.CoupledModes.of(GYRO)
    for axis in "xy":
        predicted = mg.predict_sweep(GYRO, hertz, 2e-9, axis=axis, rate="90 deg/s", harmonics=3)
        exact = modes.response(2.0 * np.pi * hertz, "xy".index(axis), np.pi / 2) * 2e-9 / GYRO.mass
        np.testing.assert_allclose(predicted.readings, exact, rtol=1e-8)
        assert np.all(predicted.settled)


@pytest.mark.parametrize("sign", [1.0, pytest.param(-1.0, marks=pytest.mark.slow)])
def test_a_bent_resonance_is_climbed_and_fallen_from(sign):
    """By six half widths: where three motions are possible, the way there shows the high one and back the low one."""
    peak = 1e-6
    force, half = peak * STIFFNESS / QUALITY, 0.5 * HERTZ / QUALITY
    cubic = sign * 6.0 * half / HERTZ * 8.0 / 3.0 * STIFFNESS / peak**2
    bent = FORK.with_effect(mg.effects.CubicStiffness("x", cubic))
    hertz = HERTZ + sign * half * np.linspace(-4.1, 9.9, 57)  # none at the very tip
    there, back = (mg.predict_sweep(bent, way, force, harmonics=3) for way in (hertz, hertz[::-1]))
    possible = [branches(one, force, cubic) for one in hertz]
    assert sum(len(one) == 3 for one in possible) > 8
    high, low = (np.array([pick(one) for one in possible]) for pick in (np.max, np.min))
    np.testing.assert_allclose(np.abs(there.readings[:, 0]), high, rtol=2e-3)
    np.testing.assert_allclose(np.abs(back.readings[::-1, 0]), low, rtol=2e-3)


@pytest.mark.slow
def test_it_is_differentiated_and_mapped():
    hertz = HERTZ + np.linspace(-20.0, 20.0, 9)

    def power(strength):
        bent = FORK.with_effect(mg.effects.CubicStiffness("x", strength))
        return jnp.sum(jnp.abs(mg.predict_sweep(bent, hertz, 2e-8, harmonics=3).readings) ** 2)

    some = 3e9
    slope = (power(1.001 * some) - power(0.999 * some)) / (0.002 * some)
    assert jax.grad(power)(some) == pytest.approx(float(slope), rel=1e-5)
    drives = jnp.array([2e-8, 4e-8])
    lot = jax.vmap(lambda drive: mg.predict_sweep(FORK, hertz, drive, harmonics=3))(drives)
    assert "each of 2 devices" in str(lot)
    np.testing.assert_allclose(lot.to_xarray()["drive"][:, 0], drives)
    assert len(lot.plot().lines) == 2
    one = mg.predict_sweep(FORK, hertz, drives[1], harmonics=3)
    np.testing.assert_allclose(lot.readings[1], one.readings, rtol=1e-9)


def test_a_model_is_read_in_volts_and_says_what_it_is(tmp_path):
    model = mg.Model(GYRO, scale=(2e5, 3e5)).with_effect(mg.effects.ElectricalFeedthrough("x", "y", 1e3))
    hertz = np.linspace(7.15e3, 7.4e3, 11)
    read, moved = (mg.predict_sweep(one, hertz, 2e-9, harmonics=3) for one in (model, GYRO))
    np.testing.assert_allclose(read.readings[:, 0], 2e5 * moved.readings[:, 0], rtol=1e-9)
    np.testing.assert_allclose(read.readings[:, 1] - 1e3 * 2e-9, 3e5 * moved.readings[:, 1], rtol=1e-7)
    assert "x: at most" in str(read)
    assert "11 rows" in str(read)
    assert read.plot().get_ylabel() == "amplitude [V]"
    again = mg.load(read.save(tmp_path / "sweep.nc"))
    np.testing.assert_allclose(again["I"].sel(channel="x"), read.readings[:, 0].real)
    assert len(read.to_pandas()) == 11


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"axis": "z"}, "one of x, y"),
        ({"harmonics": 16}, "between 1 and 15"),
        ({"frequency": -1.0}, "must be positive"),
        ({"frequency": np.zeros((2, 2))}, "a row of numbers"),
    ],
)
def test_what_cannot_be_swept_is_said(given, said):
    with pytest.raises(mg.InputError, match=said):
        mg.predict_sweep(GYRO, **{"frequency": [7.2e3], "drive": 1e-9} | given)
