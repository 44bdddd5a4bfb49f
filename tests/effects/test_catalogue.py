"""Finding effects by name, variants, and the grids of what has to be scanned."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from effects.members import MEMBERS

from memsgyro_jax import InputError
from memsgyro_jax import effects as fx
from memsgyro_jax.device.gyro import SingleMassGyro
from memsgyro_jax.device.resonator import Resonator
from memsgyro_jax.measurement.model import Model


COVERAGE = fx.Coverage(band=(1.1e5, 1.3e5), volts=0.8, durations=(0.0, 2.0, 0.5))


@pytest.mark.parametrize("effect", MEMBERS, ids=lambda effect: effect.label)
def test_every_member_is_found_by_its_name(effect):
    found = [
        fx.by_name(effect.name, effect.where),
        fx.by_name(effect.label) if effect.where else fx.by_name(effect.name),
    ]
    assert all(type(one) is type(effect) and one.label == effect.label for one in found)
    assert all(not np.any(one.strength) for one in found)


def test_own_effects_are_found_among_others():
    assert fx.by_name("centrifugal", among=fx.catalogue(1)).where == ""
    with pytest.raises(InputError, match="known are readout_delay"):
        fx.by_name("q", among=[fx.ReadoutDelay()])


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("cubic_stifness", "x"), "did you mean `cubic_stiffness`"),
        (("cubic_stiffness",), 'must say which variant, "x", "y", but says none'),
        (("cubic_stiffness", "z"), "but is given as 'z'"),
        (("thermal_drift",), '"stiffness", "damping"'),
        (("readout_delay", "x"), "has no variants, but is given as 'x'"),
        (("electrical_feedthrough", "x"), '"x_to_x", "x_to_y", "y_to_x", "y_to_y"'),
        (("",), "must be one of the catalogue"),
    ],
)
def test_a_wrong_name_is_one_sentence(arguments, words):
    with pytest.raises(InputError) as error:
        fx.by_name(*arguments)
    assert words in str(error.value)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("axis", ["z", 2, -1, None, 0.5, True])
def test_an_axis_must_be_one(axis):
    if axis is True:  # an int in Python: y
        assert fx.CubicStiffness(axis).axis == 1
        return
    with pytest.raises(InputError, match='must be "x", "y", 0 or 1'):
        fx.CubicStiffness(axis)


def test_axes_may_be_letters_or_numbers():
    assert fx.CubicStiffness("y", 2.0).axis == fx.CubicStiffness(1, 2.0).axis == 1
    assert fx.ElectricalFeedthrough("x", "y").where == fx.PickoffCrosstalk(0, 1).where == "x_to_y"


@pytest.mark.parametrize("kind", [fx.ForceMisalignment, fx.PickoffCrosstalk])
def test_a_coupling_leads_to_another_axis(kind):
    with pytest.raises(InputError, match='must be different axes, but both are "x"'):
        kind("x", "x")


@pytest.mark.parametrize(("axes", "expected"), [(1, 24), (2, 49)])
def test_only_what_fits_the_device(axes, expected):
    effects = fx.catalogue(axes)
    assert len(effects) == expected
    device = Resonator(1.2e5, 500.0, 1.0) if axes == 1 else SingleMassGyro.chi2010()
    assert Model(device, effects=effects).size == 2 * axes + 2 * axes
    assert max(map(fx.needed_axes, effects)) == axes


# What physics allows a strength; every effect stands here, those of any sign too.
ANY, POSITIVE, FACTOR, ANGLE = (-np.inf, np.inf), (0.0, np.inf), (-1.0, np.inf), (-1.0, 1.0)
RANGES = {
    "cubic_stiffness": ANY, "quadratic_stiffness": ANY, "cross_stiffness": ANY, "electrostatic_softening": POSITIVE,
    "electrostatic_cubic_stiffness": POSITIVE, "bias_transduction": POSITIVE, "thermal_curvature": ANY,
    "cross_damping_asymmetry": ANY, "quadratic_damping": POSITIVE, "squeeze_film_damping": POSITIVE,
    "dry_friction": POSITIVE, "damping_step": FACTOR, "thermal_drift": ANY, "parasitic_mode": POSITIVE,
    "rate_offset": ANY, "rate_scale_error": FACTOR, "rate_bias_drift": ANY, "angular_acceleration": (0.0, 2.0),
    "centrifugal": (0.0, 2.0), "force_misalignment": ANGLE, "drive_nonlinearity": ANY, "electrical_feedthrough": ANY,
    "readout_delay": POSITIVE, "pickoff_scale_error": FACTOR, "pickoff_nonlinearity": ANY,
    "pickoff_cubic_nonlinearity": ANY, "pickoff_crosstalk": ANGLE, "adc_saturation": POSITIVE,
    "finite_sweep_rate": POSITIVE,
}  # fmt: skip


@pytest.mark.parametrize("effect", MEMBERS, ids=lambda effect: effect.label)
def test_every_strength_stays_within_what_physics_allows(effect):
    (number,) = [n for n in fx.free_numbers(effect) if n.field == "strength"]
    assert (number.low, number.high) == RANGES[effect.name]
    assert all(n.low < n.high for n in fx.free_numbers(effect))


def test_sign_and_ends_of_a_strength_go_together():
    for sign, ends in ((1, (0.0, 3.0)), (-1, (-2.0, 0.0)), (0, (-2.0, 3.0))):

        class Own(fx.ForceEffect):
            strength: object = fx.strength(sign=sign, low=-2.0, high=3.0)

        assert Own.__dataclass_fields__["strength"].metadata["range"] == ends


def test_planar_effects_need_two_axes():
    assert {e.label for e in MEMBERS if isinstance(e, fx.Planar)} == {
        "cross_stiffness", "cross_damping_asymmetry", "rate_offset", "rate_scale_error", "rate_bias_drift",
        "angular_acceleration",
    }  # fmt: skip
    assert all(fx.needed_axes(e) == 2 for e in MEMBERS if isinstance(e, fx.Planar))


def test_scanned_fields_are_leaves():
    scanned = [e for e in MEMBERS if isinstance(e, fx.Scanned)]
    assert {e.name for e in scanned} == {"damping_step", "parasitic_mode", "adc_saturation"}
    for effect in scanned:
        assert effect.scanned
        assert all(isinstance(getattr(effect, field), jax.Array) for field in effect.scanned)


@pytest.mark.parametrize("effect", [e for e in MEMBERS if isinstance(e, fx.Scanned)], ids=lambda e: e.label)
def test_a_grid_can_be_evaluated_side_by_side(effect):
    grid = effect.grid(COVERAGE)
    assert len(grid) > 5
    stacked = jax.tree.map(lambda *leaves: jnp.stack(leaves), *grid)
    assert {one.label for one in grid} == {effect.label}
    changing = {field for field in ("strength", "omega", "quality", "time", "record") if hasattr(stacked, field)}
    moved = {field for field in changing if len(np.unique(np.asarray(getattr(stacked, field)))) > 1}
    assert moved == set(effect.scanned)


def test_the_grid_of_a_mode_covers_the_band_within_half_a_width():
    omegas = np.array([float(e.omega) for e in fx.ParasiticMode("y", quality=40.0).grid(COVERAGE)])
    assert omegas[0] < 1.1e5
    assert omegas[-1] > 1.3e5
    assert np.all(np.diff(omegas) <= omegas[1:] / 80)
    assert {e.axis for e in fx.ParasiticMode("y").grid(COVERAGE)} == {1}


def test_the_grid_of_a_step_lies_inside_records_with_a_clock():
    grid = fx.DampingStep().grid(COVERAGE)
    assert {float(e.record) for e in grid} == {1.0, 2.0}
    assert all(0 < float(e.time) < COVERAGE.durations[int(e.record)] for e in grid)
    assert fx.DampingStep().grid(fx.Coverage((1.0, 2.0), 1.0)) == ()


def test_the_grid_of_saturation_reaches_from_the_peak_to_a_square_wave():
    limits = 1 / np.array([float(e.strength) for e in fx.AdcSaturation().grid(COVERAGE)])
    assert limits.max() == pytest.approx(0.8)
    assert limits.min() == pytest.approx(0.8 * np.pi / 4)
    assert fx.AdcSaturation().grid(fx.Coverage((1.0, 2.0), 0.0)) == ()
