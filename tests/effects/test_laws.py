"""Each member against its formula in plain NumPy, signs included, and against what its physics says of energy."""

from types import SimpleNamespace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from effects.members import LABELS, MEMBERS, STRENGTHS, forces, present

from memsgyro_jax import effects as fx
from memsgyro_jax.effects.trial import methods_of, moments


M, K, D = 2e-7, np.array([[1.5e10, 1e8], [1e8, 1.6e10]]), np.array([[20.0, 1.0], [1.0, 25.0]])  # of `moments`
X, Y = np.eye(2)


def at(effect, number):
    """One moment with a non-trivial own state, and the same in NumPy."""
    now = jax.tree.map(lambda leaf: leaf[number], moments(effect, 2))
    return now, SimpleNamespace(
        **{name: np.asarray(value) for name, value in vars(now).items() if isinstance(value, jax.Array)}
    )


def crossed(n):
    """Direction of the Coriolis force."""
    return np.array([n.velocity[1], -n.velocity[0]])


def drift(s, n):
    return 2 * M * sum(c * np.sin(np.pi * (k + 0.5) * n.progress) for k, c in enumerate(s)) * crossed(n)


# label: force on the mass [N] per axis, as in the table of the contract, from strength, moment and axis.
FORCES = {
    "cubic_stiffness": lambda s, n, a: -s * n.displacement[a] ** 3 * np.eye(2)[a],
    "quadratic_stiffness": lambda s, n, a: -s * n.displacement[a] ** 2 * np.eye(2)[a],
    "cross_stiffness": lambda s, n, a: -s * np.prod(n.displacement) * np.array([n.displacement[1], n.displacement[0]]),
    "electrostatic_softening": lambda s, n, a: (
        s * (n.bias_voltage**2 - n.reference_bias**2) * n.displacement[a] * np.eye(2)[a]
    ),
    "electrostatic_cubic_stiffness": lambda s, n, a: s * n.bias_voltage**2 * n.displacement[a] ** 3 * np.eye(2)[a],
    "cross_damping_asymmetry": lambda s, n, a: np.array([-s / 2 * n.velocity[1], s / 2 * n.velocity[0]]),
    "quadratic_damping": lambda s, n, a: -s * abs(n.velocity[a]) * n.velocity[a] * np.eye(2)[a],
    "squeeze_film_damping": lambda s, n, a: -s * n.displacement[a] ** 2 * n.velocity[a] * np.eye(2)[a],
    "damping_step": lambda s, n, a: -s * M * D @ n.velocity * (n.time >= 0.4) * (n.record == 0),
    "thermal_drift stiffness": lambda s, n, a: -s * n.warming * M * np.diag(K) * n.displacement,
    "thermal_curvature stiffness": lambda s, n, a: -s * n.warming**2 * M * np.diag(K) * n.displacement,
    "thermal_curvature damping": lambda s, n, a: -s * n.warming**2 * M * np.diag(D) * n.velocity,
    "thermal_drift damping": lambda s, n, a: -s * n.warming * M * np.diag(D) * n.velocity,
    "parasitic_mode": lambda s, n, a: s * M * (2 * np.pi * 20e3) ** 2 * (n.own[0] - n.displacement[a]) * np.eye(2)[a],
    "rate_offset": lambda s, n, a: 2 * M * s * (1 - n.rate_trusted) * crossed(n),
    "rate_scale_error": lambda s, n, a: 2 * M * s * n.rate * crossed(n),
    "rate_bias_drift": lambda s, n, a: drift(s, n),
    "angular_acceleration": lambda s, n, a: (
        s * M * n.angular_acceleration * np.array([n.displacement[1], -n.displacement[0]])
    ),
    "centrifugal": lambda s, n, a: s * M * n.rate**2 * n.displacement,
}


def volts(n):
    return n.scale * n.displacement


# label: voltages, from strength, moment and the axes that the label names.
SIGNALS = {
    "electrical_feedthrough": lambda s, n, a, b: volts(n) + s * n.force[a] * np.eye(2)[b],
    "bias_transduction pickoff": lambda s, n, a, b: volts(n) * (n.bias_voltage / n.reference_bias) ** s,
    "pickoff_scale_error": lambda s, n, a, b: volts(n) * (1 + s * np.eye(2)[a]),
    "pickoff_nonlinearity": lambda s, n, a, b: n.scale * (n.displacement + s * n.displacement[a] ** 2 * np.eye(2)[a]),
    "pickoff_cubic_nonlinearity": lambda s, n, a, b: (
        n.scale * (n.displacement + s * n.displacement[a] ** 3 * np.eye(2)[a])
    ),
    "pickoff_crosstalk": lambda s, n, a, b: volts(n) + s * n.scale * n.displacement[a] * np.eye(2)[b],
    "adc_saturation": lambda s, n, a, b: np.clip(volts(n), -1 / s, 1 / s),
    "readout_delay": lambda s, n, a, b: (
        volts(n) + n.scale * (-s * n.velocity + s**2 / 2 * n.acceleration - s**3 / 6 * n.jerk)
    ),
}


def places(effect) -> list[int]:
    """The axes in a label: [0] for x, [1, 0] for y_to_x."""
    return ["xy".index(letter) for letter in effect.where.split("_to_") if letter in ("x", "y")]


def law(table, effect):
    return table.get(effect.label) or table.get(effect.name)


def configured(effect):
    effect = present(effect)
    return fx.DampingStep(effect.strength, time=0.4) if isinstance(effect, fx.DampingStep) else effect


@pytest.mark.parametrize("number", [1, 2, 3])
@pytest.mark.parametrize("effect", [e for e in MEMBERS if law(FORCES, e)], ids=lambda e: e.label)
def test_force(effect, number):
    effect = configured(effect)
    now, plain = at(effect, number)
    axis = (places(effect) or [0])[0]
    expected = law(FORCES, effect)(np.asarray(effect.strength), plain, axis)
    np.testing.assert_allclose(effect.force(now), expected, rtol=1e-12, atol=1e-12 * np.abs(expected).max())


@pytest.mark.parametrize("number", [1, 2, 3])
@pytest.mark.parametrize("effect", [e for e in MEMBERS if law(SIGNALS, e)], ids=lambda e: e.label)
def test_signal(effect, number):
    effect = present(effect)
    now, plain = at(effect, number)
    a, b = [*places(effect), 0, 0][:2]
    expected = law(SIGNALS, effect)(np.asarray(effect.strength), plain, a, b)
    np.testing.assert_allclose(effect.signal(now.scale * now.displacement, now), expected, rtol=1e-12)


def test_every_member_has_its_formula_here():
    elsewhere = {"dry_friction", "force_misalignment", "drive_nonlinearity", "finite_sweep_rate", "bias_transduction"}
    missing = {e.name for e in MEMBERS if not (law(FORCES, e) or law(SIGNALS, e))}
    assert missing == elsewhere


@pytest.mark.parametrize(("source", "target"), [(0, 1), (1, 0)])
def test_force_misalignment(source, target):
    now, plain = at(fx.ForceMisalignment(), 1)
    expected = plain.force + 0.03 * plain.force[source] * np.eye(2)[target]
    given = fx.ForceMisalignment(source, target, 0.03).applied(now.force, now)
    np.testing.assert_allclose(given, expected, rtol=1e-14)


@pytest.mark.parametrize("axis", [0, 1])
def test_drive_nonlinearity(axis):
    now, plain = at(fx.DriveNonlinearity(), 1)
    expected = plain.force + 1e6 * plain.force[axis] ** 2 * np.eye(2)[axis]
    np.testing.assert_allclose(fx.DriveNonlinearity(axis, 1e6).applied(now.force, now), expected, rtol=1e-14)


@pytest.mark.parametrize(
    ("bias", "reference", "gain"), [(3.0, 2.0, 1.5), (-1.0, 2.0, 0.5), (0.0, 2.0, 1), (3.0, 0.0, 1)]
)
def test_a_transducer_goes_with_its_bias_and_none_without_one_does(bias, reference, gain):
    now, _ = at(fx.DriveTransduction(), 1)
    now = eqx.tree_at(lambda n: (n.bias_voltage, n.reference_bias), now, (jnp.asarray(bias), jnp.asarray(reference)))
    volts = now.scale * now.displacement
    for power in (0.0, 1.0, 2.0):
        given, seen = fx.DriveTransduction(power), fx.PickoffTransduction(power)
        np.testing.assert_allclose(given.applied(now.force, now), gain**power * now.force, rtol=1e-14)
        np.testing.assert_allclose(seen.signal(volts + 0.01, now), gain**power * volts + 0.01, rtol=1e-13)
        slope = jax.grad(lambda s: fx.DriveTransduction(s).applied(now.force, now)[0])(power)
        np.testing.assert_allclose(slope, gain**power * np.log(gain) * now.force[0], rtol=1e-13)


@pytest.mark.parametrize("axis", [0, 1])
def test_dry_friction_is_a_sign_that_is_rounded_where_the_mass_turns(axis):
    now, _ = at(fx.DryFriction(axis), 1)
    for v, q in ((0.1, 0.0), (-0.1, 0.0), (1e-3, 1e-9), (-7.0, 1e-6)):
        there = SimpleNamespace(**vars(now) | {"velocity": v * jnp.eye(2)[axis], "displacement": q * jnp.eye(2)[axis]})
        force = fx.DryFriction(axis, 2e-9).force(there)
        np.testing.assert_allclose(force, -2e-9 * np.sign(v) * np.eye(2)[axis], rtol=1e-2)


def test_dry_friction_takes_four_strengths_times_the_amplitude_per_cycle():
    """The classic 4·s·a, less the 1.1 % that the docstring tells of, at amplitudes a factor of a million apart."""
    theta = 2 * np.pi * np.arange(512) / 512
    now = jax.tree.map(lambda leaf: leaf[0], moments(fx.DryFriction(), 1))
    omega = np.sqrt(float(now.device.stiffness[0]))
    for amplitude in (1e-10, 1e-7, 1e-4):
        q, v = amplitude * np.sin(theta), amplitude * omega * np.cos(theta)

        def force(one_q, one_v):
            there = SimpleNamespace(**vars(now) | {"displacement": one_q[None], "velocity": one_v[None]})
            return fx.DryFriction(0, 3.0).force(there)[0]

        work = float(jnp.sum(jax.vmap(force)(jnp.asarray(q), jnp.asarray(v)) * v / omega)) * 2 * np.pi / 512
        assert work == pytest.approx(-4 * 3.0 * amplitude * 0.98893, rel=1e-3 if amplitude > 1e-9 else 0.02)


def test_own_state_of_a_parasitic_mode():
    """z'' = −ω²·(z − q) − (ω/Q)·z', for the state (z, z'/ω)."""
    effect = fx.ParasiticMode(1, 0.01, omega=1.1e5, quality=50.0)
    now, plain = at(effect, 2)
    z, z_rate = plain.own[0], plain.own[1] * 1.1e5
    acceleration = -(1.1e5**2) * (z - plain.displacement[1]) - 1.1e5 / 50.0 * z_rate
    np.testing.assert_allclose(effect.own_rate(now), [z_rate, acceleration / 1.1e5], rtol=1e-13)


def test_saturation_clips_at_one_over_the_strength():
    now, _ = at(fx.AdcSaturation(), 1)
    given = fx.AdcSaturation(0.5).signal(jnp.array([3.0, -1.0]), now)
    np.testing.assert_array_equal(given, [2.0, -1.0])


DISSIPATIVE = ("quadratic_damping", "squeeze_film_damping", "dry_friction", "damping_step")
WORKLESS = ("cross_damping_asymmetry", "rate_offset", "rate_scale_error", "rate_bias_drift")
POTENTIALS = {
    "cubic_stiffness x": lambda s, x, y: s * x**4 / 4,
    "cubic_stiffness y": lambda s, x, y: s * y**4 / 4,
    "quadratic_stiffness x": lambda s, x, y: s * x**3 / 3,
    "quadratic_stiffness y": lambda s, x, y: s * y**3 / 3,
    "cross_stiffness": lambda s, x, y: s * x**2 * y**2 / 2,
}


def powers(effect):
    """Power [W] that an effect feeds into the motion at some instants in motion."""
    found = []
    for number in (1, 2, 3, 4):
        now, plain = at(effect, number)
        force = np.asarray(effect.force(now))
        found.append((force @ plain.velocity, np.abs(force * plain.velocity).sum()))
    return np.array(found).T


@pytest.mark.parametrize("effect", [e for e in forces(MEMBERS) if e.name in DISSIPATIVE], ids=lambda e: e.label)
def test_damping_takes_energy(effect):
    power, _ = powers(present(effect))
    assert np.all(power < 0)


@pytest.mark.parametrize("effect", [e for e in forces(MEMBERS) if e.name in WORKLESS], ids=lambda e: e.label)
def test_gyroscopic_forces_do_no_work(effect):
    power, parts_of_it = powers(present(effect))
    assert np.all(np.abs(power) <= 1e-15 * parts_of_it)
    assert np.all(parts_of_it > 0)


@pytest.mark.parametrize("label", POTENTIALS)
def test_springs_conserve_energy(label):
    """The force is minus the gradient of a potential."""
    effect = present(MEMBERS[LABELS.index(label)])
    potential = POTENTIALS[label]
    for number in (1, 2):
        now, plain = at(effect, number)
        gradient = jax.grad(lambda q: potential(STRENGTHS[effect.name], q[0], q[1]))(jnp.asarray(plain.displacement))
        np.testing.assert_allclose(effect.force(now), -gradient, rtol=1e-12)


def test_a_sweep_has_the_speed_of_its_strength():
    effect = fx.FiniteSweepRate(12.5)
    assert float(effect.speed()) == 12.5
    assert methods_of(effect)[0].method == "speed"
