"""What a model predicts of every kind of record, against a laboratory that integrates the motion itself.

The laboratory knows nothing of the package: it takes forces in newtons and its own formulas, and is good to 1e-10.
"""

from dataclasses import replace

import equinox as eqx
import numpy as np
import pytest
from bench_case import DIE, EFFECTS, OF_X, ONE_AXIS, RESONATOR, TINY, bench, strengths, truth
from lab.die import Hidden
from lab.protocol import RingDown as RingDownOfLab
from lab.strengths import VISIBLE, visible

from memsgyro_jax.base.errors import InputError
from memsgyro_jax.diagnosis.fit import CaseFit, fit_case
from memsgyro_jax.effects import AdcSaturation, DampingStep, ParasiticMode
from memsgyro_jax.measurement.case import load_case, write_case
from memsgyro_jax.measurement.experiments import RingDown


SWEEPS = ("sweep_x", "sweep_y", "bias", "soak")


def errors(hidden: Hidden, effects=EFFECTS) -> dict[str, float]:
    """Largest error of each record's prediction, relative to the largest reading of the record."""
    made = bench(hidden)
    return compared(made, fit_case(made.case, model=made.model(effects), held=True))


def compared(made, fit: CaseFit) -> dict[str, float]:
    out = {}
    for index, record in enumerate(made.case.records):
        clean = made.records[record.name].clean
        out[record.name] = np.max(np.abs(fit.predicted(index) - clean)) / np.max(np.abs(clean))
    return out


def bounds(sweep: float, ring_down: float, rate: float, raw: float) -> dict[str, float]:
    return dict.fromkeys(SWEEPS, sweep) | {"ringdown": ring_down, "rate": rate, "raw": raw}


# Sweeps are solved, the others integrated. Linear motion under held forces is exact; a rate that changes from block to
# block, and nonlinear forces, are taken to second order in the step, which leaves far less than the noise.
LINEAR = bounds(1e-10, 3e-11, 2e-6, 1e-11)
SMOOTH = bounds(1e-10, 2e-6, 2e-6, 1e-7)
# |v| has a corner that three harmonics round off.
CORNERED = bounds(4e-5, 3e-5, 2e-4, 1e-6)
# Friction is smoothed: 1.1 % less work per cycle of it; a mass that it holds creeps in the model and stands in truth.
STICKING = bounds(2e-2, 1e-3, 2e-3, 1e-4)
ACCURACY = dict.fromkeys(VISIBLE, LINEAR)
ACCURACY |= dict.fromkeys([n for n in VISIBLE if "stiffness" in n or "squeeze" in n], SMOOTH)
ACCURACY |= {n: CORNERED for n in VISIBLE if n.startswith("quadratic_damping")}
ACCURACY |= {n: STICKING for n in VISIBLE if n.startswith("dry_friction")}
# Over time the first derivatives of the motion stand for the delay: (ωτ)⁴/24 of the amplitude is left.
ACCURACY |= {"readout_delay": bounds(1e-10, 2e-6, 2e-6, 2e-6)}
ACCURACY |= {"thermal_drift_stiffness": LINEAR, "cross_stiffness": bounds(1e-10, 2e-6, 4e-5, 1e-7)}
# Three terms of an asymptotic series in the speed over the square of the half width.
ACCURACY |= {"finite_sweep_rate": bounds(1e-5, 3e-11, 2e-6, 1e-11)}
SCANNED = ("parasitic_mode_x", "parasitic_mode_y", "damping_step", "adc_saturation")


def assert_within(found: dict[str, float], bound: dict[str, float]) -> None:
    too_far = {name: (value, bound[name]) for name, value in found.items() if not value <= bound[name]}
    assert not too_far, too_far


@pytest.mark.slow
def test_a_die_with_nothing_hidden():
    assert_within(errors(Hidden(), OF_X), LINEAR)


@pytest.mark.slow
def test_a_hidden_spring_is_predicted():
    assert_within(errors(visible("cubic_stiffness_x"), OF_X), ACCURACY["cubic_stiffness_x"])


@pytest.mark.slow
def test_several_linear_effects_at_once_are_predicted():
    hidden = visible(
        "electrostatic_softening_x", "electrostatic_softening_y", "cross_damping_asymmetry", "thermal_drift_damping",
        "angular_acceleration", "centrifugal", "force_misalignment_x_to_y",
        "electrical_feedthrough_x_to_x", "electrical_feedthrough_y_to_x", "pickoff_crosstalk_x_to_y",
    )  # fmt: skip
    assert_within(errors(hidden), LINEAR)


@pytest.mark.slow
def test_the_comparison_would_see_a_wrong_strength():
    """A thousandth of a visible cubic stiffness is a thousand times what the tolerance allows."""
    made = bench(visible("cubic_stiffness_x"), protocol=replace(TINY, experiments=TINY.experiments[:1]))
    off = truth(made.case, DIE, visible("cubic_stiffness_x", times=1.001), OF_X)
    found = compared(made, fit_case(made.case, model=off, held=True))
    assert found["sweep_x"] > 1e3 * ACCURACY["cubic_stiffness_x"]["sweep_x"]


# ---- the whole catalogue


@pytest.mark.slow
@pytest.mark.parametrize("name", [n for n in VISIBLE if n not in SCANNED])
def test_every_effect_is_predicted(name):
    assert_within(errors(visible(name)), ACCURACY[name])


@pytest.mark.slow
@pytest.mark.parametrize("axis", ["x", "y"])
def test_a_parasitic_mode_is_predicted(axis):
    hidden = visible(f"parasitic_mode_{axis}")
    effect = ParasiticMode(axis, omega=hidden.parasitic_mode_frequency, quality=hidden.parasitic_mode_quality)
    assert_within(errors(hidden, (effect,)), LINEAR)


@pytest.mark.slow
def test_a_damping_step_is_predicted():
    """Up to the one block within which it happens."""
    hidden = replace(visible("damping_step"), damping_step_record="rate", damping_step_time=0.06)
    made = bench(hidden)
    number = [r.name for r in made.case.records].index("rate")
    model = made.model((DampingStep(time=0.06, record=float(number)),))
    assert_within(compared(made, fit_case(made.case, model=model, held=True)), LINEAR | {"rate": 1e-3})


def test_a_ring_down_is_read_at_its_own_times(tmp_path):
    """Stamps that jitter by half an interval, a tenth of the rows lost; the noise is told without a clock."""
    ring = RingDownOfLab("ringdown", 0, 0.012, 0.2, 1 / 300, 200, 1e-4, "fit", jitter=0.5)
    made = bench(Hidden(), 0, replace(ONE_AXIS, experiments=(ring,), declare_noise=False), RESONATOR)
    (record,) = made.case.records
    predicted = eqx.filter_jit(record.experiment(made.case, 0).predict)(made.model(()))
    clean = made.records["ringdown"].clean
    assert np.max(np.abs(predicted - clean)) < 1e-9 * np.max(np.abs(clean))
    assert record.noise_level == pytest.approx(1e-4, rel=0.25)
    write_case(made.case, tmp_path / "again")
    toml = tmp_path / "again" / "case.toml"
    toml.write_text(toml.read_text().replace("uneven = true", "uneven = false"))
    with pytest.raises(InputError, match="say `uneven = true`"):
        load_case(toml.parent)


@pytest.mark.slow
def test_a_saturated_converter_is_predicted():
    """Sweeps see a clipped wave through 256 samples of a period; the table stays below the range."""
    found = errors(visible("adc_saturation"), (AdcSaturation(),))
    assert_within(found, bounds(2e-4, 1e-11, 2e-6, 1e-11))


@pytest.mark.slow
def test_the_error_of_a_ring_down_falls_with_the_square_of_the_step():
    made = bench(visible("cubic_stiffness_x"))
    effects = strengths(made.hidden, (EFFECTS[0],))
    fit = fit_case(made.case, model=truth(made.case, DIE, made.hidden, effects), held=True)
    ring = next(r.experiment for r in fit.joint.readings if isinstance(r.experiment, RingDown))
    clean = made.records["ringdown"].clean
    assert ring.steps == 12  # whose error is three times what the laboratory's own integration leaves
    coarse, fine = (
        np.max(np.abs(eqx.filter_jit(replace(ring, steps=steps).predict)(fit.model) - clean)) for steps in (3, 6)
    )
    assert 3.5 < coarse / fine < 4.5
