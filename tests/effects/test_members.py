"""Promises that every member of the catalogue keeps."""

import dataclasses
import inspect

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from effects.members import AXES_AND_MEMBERS, CONDITIONS, LABELS, MEMBERS, STRENGTHS, model, present, seen, state_of

import memsgyro_jax as mg
from memsgyro_jax import effects as fx
from memsgyro_jax.effects.trial import PORT_METHODS, at_strength, complaint, methods_of, moments


every = pytest.mark.parametrize("effect", MEMBERS, ids=LABELS)
every_axes = pytest.mark.parametrize(
    ("axes", "effect"), AXES_AND_MEMBERS, ids=[f"{effect.label}, {axes} axes" for axes, effect in AXES_AND_MEMBERS]
)


def test_the_catalogue_is_complete():
    assert len(MEMBERS) == len(set(LABELS)) == 49
    assert {effect.name for effect in MEMBERS} == set(STRENGTHS)
    assert {type(effect) for effect in MEMBERS} == set(fx.CATALOGUE)
    assert all(fx.needed_axes(effect) == 1 for effect in fx.catalogue(1))


@pytest.mark.parametrize("kind", fx.CATALOGUE, ids=lambda kind: kind.__name__)
def test_a_member_is_described(kind):
    assert issubclass(kind, tuple(PORT_METHODS))
    assert kind.unit
    assert kind.law
    text = " ".join(inspect.getdoc(kind).split())
    assert "Zero:" in text
    assert "Shows" in text, "when it shows"
    author = kind.reference.split(",")[0].split(" et al")[0].split(" and ")[0]
    assert author in text, "the docstring gives the reference in full"


@every_axes
def test_zero_is_absent_exactly(axes, effect):
    """Bit by bit, at an instant where nothing is zero."""
    without, within = model(axes=axes), model(effect, axes=axes)
    state = state_of(within)
    slope, volts = seen(within, state)
    expected_slope, expected_volts = seen(without, state[: 2 * axes])
    np.testing.assert_array_equal(slope[: 2 * axes], expected_slope)
    np.testing.assert_array_equal(volts, expected_volts)


@every_axes
def test_keeps_the_promises_asked_of_a_users_effect(axes, effect):
    assert complaint(effect, axes) == ""


@every
def test_derivatives_are_finite_and_tell(effect):
    """Finite by every leaf, at zero strength and beyond, also at rest; and not zero where a fit starts."""
    now = moments(effect, 2)
    for part in methods_of(effect):

        def value(e, part=part):
            return jax.vmap(lambda n: jnp.asarray(part.value(e, n)))(now)

        reverse = jax.grad(lambda e, value=value: jnp.sum(value(e)))
        slopes = jax.jit(lambda e, value=value, reverse=reverse: (jax.jacfwd(value)(e), reverse(e)))
        absent, there = slopes(effect), slopes(present(effect))
        assert all(np.all(np.isfinite(leaf)) for leaf in jax.tree.leaves((absent, there)))
        if part.exact and "strength" not in getattr(effect, "scanned", ()):
            assert np.max(np.abs(absent[0].strength)) > 0


@every
def test_present_differs_from_absent(effect):
    if isinstance(effect, fx.SweepEffect):
        assert present(effect).speed() != effect.speed()
        return
    absent = seen(model(effect), state := state_of(model(effect)))
    changed = seen(model(present(effect)), state)
    assert any(bool(jnp.any(a != b)) for a, b in zip(absent, changed, strict=True))


@every
def test_leaves_are_arrays(effect):
    leaves = jax.tree.leaves(effect)
    assert leaves
    assert all(isinstance(leaf, jax.Array) and jnp.issubdtype(leaf.dtype, jnp.floating) for leaf in leaves)
    assert any(leaf is effect.strength for leaf in leaves)


@every
def test_many_at_once_are_the_same_as_one_by_one(effect):
    factors = np.array([0.0, 0.5, 2.0])
    many = jax.vmap(lambda factor: present(effect, factor))(factors)
    state = state_of(model(effect))
    together = jax.vmap(lambda e: seen(model(e), state))(many) if not isinstance(effect, fx.SweepEffect) else None
    for row, factor in enumerate(factors):
        one = present(effect, factor)
        if together is None:
            assert jax.vmap(lambda e: e.speed())(many)[row] == one.speed()
            continue
        for a, b in zip(together, seen(model(one), state), strict=True):
            np.testing.assert_allclose(a[row], b, rtol=1e-13, atol=0)


def test_strengths_do_not_compile_anew():
    """The set of effects is structure, their strengths are numbers: one program for all strengths."""
    traced = []

    @eqx.filter_jit
    def run(of, state):
        traced.append(1)
        return seen(of, state)

    state = state_of(model(*MEMBERS))
    results = [
        run(model(*(at_strength(e, factor * present(e).strength) for e in MEMBERS)), state)[0]
        for factor in (0.5, 1.0, 2)
    ]
    assert len(traced) == 1
    assert not np.array_equal(results[0], results[1])


def test_all_members_together_at_zero_are_the_base_model():
    of = model(*MEMBERS)
    state = state_of(of)
    slope, volts = seen(of, state)
    expected_slope, expected_volts = seen(model(), state[:4])
    np.testing.assert_array_equal(slope[:4], expected_slope)
    np.testing.assert_array_equal(volts, expected_volts)


@pytest.mark.parametrize("kind", [fx.RateOffset, fx.RateBiasDrift])
def test_a_calibrated_record_has_no_rate_error(kind):
    trusted = eqx.tree_at(lambda c: c.rate_trusted, CONDITIONS, jnp.asarray(1.0))
    state = state_of(model())
    given = seen(model(present(kind())), state, trusted)[0]
    np.testing.assert_array_equal(given, seen(model(), state, trusted)[0])


def test_damping_steps_in_its_own_record_from_its_own_time_on():
    step, state = fx.DampingStep(0.5, time=0.2, record=3.0), state_of(model())

    def force(time, record):
        at = eqx.tree_at(lambda c: (c.time, c.record), CONDITIONS, (jnp.asarray(time), jnp.asarray(record)))
        return np.asarray(seen(model(step), state, at)[0] - seen(model(), state, at)[0])[2:]

    assert np.all(force(0.2, 3.0) != 0)
    np.testing.assert_array_equal(force(0.2, 3.0), force(9.0, 3.0))
    for time, record in ((0.199, 3.0), (0.3, 2.0), (0.3, 4.0)):
        assert not np.any(force(time, record))


def test_declared_linear_own_states_are_linear():
    """`own_is_linear` lets the harmonic balance leave those rows out: it had better be true."""
    for effect in (e for e in MEMBERS if e.own_size):
        assert effect.own_is_linear
        of = model(present(effect))
        matrix, gain = of.linear(CONDITIONS)
        state = state_of(of)
        slope = of.derivative(state, FORCE := np.array([1e-8, -2e-8]), CONDITIONS)
        np.testing.assert_allclose(slope[4:], (matrix @ state + gain @ FORCE)[4:], rtol=1e-12)


@every
def test_a_strength_is_a_finite_number(effect):
    shape = np.shape(effect.strength)
    for given, words in (
        (np.full(shape, np.nan), "finite, but nan"), (np.full(shape, -np.inf), "finite, but -inf"),
        ("3 furlongs", "Unit of the value"), ("fast", "number with a unit"), (None, "must be a number in"),
    ):  # fmt: skip
        with pytest.raises(mg.InputError, match=rf"^Argument `strength`.*{words}"):
            dataclasses.replace(effect, strength=given)


def test_a_strength_in_its_unit_and_in_another_one():
    assert fx.CubicStiffness("x", "800 N/m/mm^2").strength == pytest.approx(8e8)
    assert fx.PickoffScaleError("x", "1 %").strength == pytest.approx(0.01)
    assert fx.ParasiticMode("x", 1e-3, omega="180e3 rad/s").omega == 180e3
    assert fx.SelfHeating(1.0, power="2 mW").power == pytest.approx(2e-3)
    with pytest.raises(mg.InputError, match=r'^Argument `strength`: .*"N/m³", but is "N/m"'):
        fx.CubicStiffness("x", "3 N/m")
    with pytest.raises(mg.InputError, match=r"^Argument `omega`"):
        fx.ParasiticMode("x", 1e-3, omega="fast")


def test_a_strength_may_be_traced():
    def square(strength):
        return fx.CubicStiffness("x", strength).strength ** 2

    assert jax.jit(square)(3.0) == 9.0
    assert jax.grad(square)(3.0) == 6.0
    np.testing.assert_array_equal(jax.vmap(square)(jnp.array([1.0, 2.0])), [1.0, 4.0])
    assert np.isnan(jax.jit(square)(np.nan))
