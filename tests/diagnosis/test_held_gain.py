"""A device of one axis that nothing drives: its strengths are those of one resonator, whatever the design guessed."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from memsgyro_jax.device.normalised import NormalisedDevice
from memsgyro_jax.diagnosis.estimates import whose_forces
from memsgyro_jax.diagnosis.fit import fit_case
from memsgyro_jax.diagnosis.law import draw_law
from memsgyro_jax.effects import CubicStiffness, QuadraticDamping
from memsgyro_jax.measurement.case import load_case, write_case
from memsgyro_jax.measurement.declared import DesignValue, Readout
from memsgyro_jax.measurement.model import Model


HERTZ, QUALITY, DRAG = 40.0, 120.0, 6e-3  # x'' + ω/Q·x' + DRAG·|x'|·x' + ω²·x = 0, x in volts
OMEGA = 2 * np.pi * HERTZ
CASE = """
schema = "memsgyro-case/1"
name = "decay"
device = "resonator"

[design]
resonance = {{ value = {hertz}, unit = "Hz", tolerance = 0.2 }}
quality_factor = {{ low = 30, high = 500, unit = "1" }}
{more}

[[experiment]]
name = "decay"
kind = "free_decay"
file = "decay.csv"
noise_std = {{ value = 1, unit = "mV" }}
"""
OF_A_MASS = """
mass = { value = 2, unit = "mg", tolerance = 0.1 }
[readout]
scale = { value = 1, unit = "V/um" }
[drive]
unit = "N"
"""


@pytest.fixture(scope="module")
def decay(tmp_path_factory):
    """A folder with a decay by a viscous and a quadratic drag."""
    folder, time = tmp_path_factory.mktemp("decay"), np.arange(2000) * 2e-3
    rates = lambda _, s: [s[1], -(OMEGA / QUALITY) * s[1] - DRAG * abs(s[1]) * s[1] - OMEGA**2 * s[0]]  # noqa: E731
    shown = solve_ivp(rates, (0, time[-1]), (1.0, 0.0), t_eval=time, rtol=1e-10, atol=1e-12, method="DOP853").y[0]
    volts = shown + 1e-3 * np.random.default_rng(8).standard_normal(time.size)
    np.savetxt(folder / "decay.csv", np.column_stack([time, volts]), delimiter=",", header="t [s],y [V]", comments="")
    return folder


def case_of(folder, hertz=HERTZ, more=""):
    (folder / "case.toml").write_text(CASE.format(hertz=hertz, more=more))
    return load_case(folder)


def dragged(case):
    return fit_case(case, [QuadraticDamping("x")])


@pytest.mark.parametrize("hertz", [35.0, 40.0, 44.0])
def test_strengths_are_those_of_a_device_of_stiffness_one(decay, hertz):
    """In volts of displacement, with the resonance that the fit found."""
    fit = dragged(case_of(decay, hertz))
    (found,) = [e for e in fit.estimates if e.name == "quadratic_damping x"]
    assert found.value == pytest.approx(DRAG / OMEGA**2, rel=0.02)
    assert abs(found.value - DRAG / OMEGA**2) < 4.0 * found.std
    assert float(fit.model.device.mobility) == pytest.approx(float(fit.model.device.stiffness[0]), rel=1e-12)
    assert float(fit.device.static_gain) == pytest.approx(1.0, rel=1e-12)
    assert whose_forces(fit) == (
        "nothing drives the device, so that no record tells its mass: strengths are those of a stiffness of 1 V/V"
    )
    assert whose_forces(fit) in str(fit)
    assert whose_forces(fit_case(fit.case)) == "", "a model without a force has no strength"


def test_a_gain_that_is_declared_is_held_as_well(decay):
    fit = dragged(case_of(decay, 44.0, 'static_gain = { value = 4, unit = "1", tolerance = 0 }'))
    assert float(fit.device.static_gain) == pytest.approx(4.0, rel=1e-12)
    assert "strengths are those of a stiffness of 0.25 V/V" in whose_forces(fit)


def test_a_mass_that_is_declared_stays(decay, tmp_path):
    """It scales forces, and the resonance has no say; the case that is written again says so too."""
    case = case_of(decay, 44.0, OF_A_MASS)
    for one in (case, load_case(write_case(case, tmp_path / "again"))):
        fit = dragged(one)
        assert 1.0 / float(fit.model.device.mobility) == pytest.approx(2e-6, rel=1e-9)
        (found,) = [e for e in fit.estimates if e.name == "quadratic_damping x"]
        assert found.value == pytest.approx(2e-6 * DRAG * 1e6, rel=0.02)  # 1 V is a micrometre
        assert whose_forces(fit) == ""


def test_of_two_axes_it_is_the_mass_that_is_said():
    device = NormalisedDevice([4e8, 5e8, 0.0], [20.0, 30.0, 0.0], 1.0)
    words = SimpleNamespace(displacement="V", force="V")
    case = SimpleNamespace(words=words, readout=Readout(1.0), design={"mass": DesignValue.found(1.0)})
    fit = SimpleNamespace(case=case, joint=SimpleNamespace(undriven=True), model=Model(device))
    assert whose_forces(fit) == ""
    fit.model = fit.model.with_effect(CubicStiffness("x", 1e3))
    assert whose_forces(fit).endswith("strengths are those of a mass of 1 (V·s²/V)")
    case.design["mass"] = DesignValue(2e-9, 1e-9, 3e-9)
    assert whose_forces(fit) == ""


def test_a_law_that_is_drawn_is_that_of_the_same_device(decay):
    """Also where the linear device that stands beside it is another one than the base model."""
    drawn = draw_law(fit_case(case_of(decay, 44.0)), terms=1)
    device = drawn.beside.device
    assert float(device.mobility) == pytest.approx(float(device.stiffness[0]), rel=1e-12)
    (term,) = drawn.terms
    assert term.kind == "damping"
    speed = 0.5 * term.size
    drawn_force = term.strength * speed * 0.5**term.exponent
    assert drawn_force == pytest.approx(DRAG / OMEGA**2 * speed**2, rel=0.2)  # it is not fitted yet
