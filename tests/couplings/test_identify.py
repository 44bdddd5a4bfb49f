"""Identification against an independent laboratory: right values, honest uncertainty, honest verdicts."""

import json
from dataclasses import replace
from types import SimpleNamespace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from kept import kept
from lab import two_modes as lab

from memsgyro_jax.base.errors import InputError
from memsgyro_jax.couplings.bench import Bench, LockIn
from memsgyro_jax.couplings.doubts import Explanation, doubt, rivals
from memsgyro_jax.couplings.estimates import channel_values, products
from memsgyro_jax.couplings.frequency_sweep import FrequencySweep
from memsgyro_jax.couplings.identify import identify, sweep_of
from memsgyro_jax.couplings.identify_ratio import identify_by_ratio
from memsgyro_jax.couplings.likelihood import fit_sweeps, free_parameters, gauge_fixed, refit, refit_draws
from memsgyro_jax.couplings.modes import CoupledModes
from memsgyro_jax.couplings.record import SweepRecord
from memsgyro_jax.couplings.result import CouplingCoefficient
from memsgyro_jax.couplings.sense_view import SeenBench
from memsgyro_jax.couplings.tree_fit import evaluate
from memsgyro_jax.measurement.experiments import PolarNoise
from memsgyro_jax.measurement.least_squares import gate


INSTRUMENT = lab.Instrument(ratio=1.3, asymmetry=np.radians(2.4), drive_ratio=0.8 * np.exp(0.3j))
RAW = PolarNoise.from_peak_to_peak(lab.RAW[0], np.radians(lab.RAW[1]))
FILTERED = PolarNoise.from_peak_to_peak(lab.FILTERED[0], np.radians(lab.FILTERED[1]))
# A gyroscope slow enough to integrate its equations through a sweep.
SLOW = lab.Gyro(mass=1e-6, fx=60.0, fy=63.0, qx=150.0, qy=90.0, cxy=4e-7, kxy=3e-3, lam_yx=0.03, lam_xy=-0.02)
SLOW_BAND = np.linspace(55.0, 69.0, 1001)


def record(phasors, frequency=lab.WIDE, axis=0):
    """What the reader makes of a file, without the file."""
    w = 2 * np.pi * frequency
    one = np.ones(len(w))
    return SweepRecord("sweep.csv", w, phasors, axis, one, one * w[0], 0.0, True, None, "1")


def swept(gyro, frequency=lab.WIDE, noise=lab.RAW, axis=0, seed=0, instrument=INSTRUMENT, motion=None):
    clean = lab.record(gyro, instrument, frequency, axis, motion)
    return record(lab.noisy(clean, *noise, np.random.default_rng(seed)) if noise else clean, frequency, axis)


def seen_bench(gyro=None, instrument=INSTRUMENT):
    gyro = gyro or lab.Gyro()
    damping = gyro.matrices()[1]
    device = CoupledModes.from_coefficients(gyro.mass, gyro.matrices()[2], damping, gyro.lam_yx, gyro.lam_xy)
    readout = LockIn(abs(instrument.gain), np.angle(instrument.gain), instrument.ratio, instrument.asymmetry)
    return SeenBench.of(Bench(device, readout))


def assert_within(coefficient, truth, sigmas=4.0):
    assert abs(coefficient.value - truth) < sigmas * coefficient.std, f"{coefficient} is not {truth}"


@pytest.fixture(scope="module")
def wide():
    return identify([swept(lab.Gyro())], noise=RAW, mass=3e-7)


def test_wide_sweep_returns_every_coefficient(wide):
    truth = lab.Gyro()
    assert_within(wide.coefficients["lambda_yx"], truth.lam_yx)
    assert_within(wide.coefficients["c_xy"], truth.cxy)
    assert_within(wide.coefficients["k_xy"], truth.kxy)
    assert_within(wide.readout["gain_ratio"], INSTRUMENT.ratio)
    assert_within(wide.readout["phase_asymmetry_deg"], 2.4)
    assert_within(wide.modal["f_y"], truth.fy)
    assert_within(wide.modal["q_x"], truth.qx)
    assert wide.readout["phase_asymmetry_deg"].std < 0.06
    assert {wide.coefficients[name].verdict for name in ("lambda_yx", "c_xy", "k_xy")} == {"identified"}
    assert "drive the y electrode" in wide.coefficients["lambda_xy"].verdict
    assert wide.explained
    (note,) = [note for note in wide.notes if "pick-offs" in note]
    assert "counts as lambda and k_xy" in note
    assert note in str(wide)


def test_what_sweeps_leave_open_has_no_value_and_the_products_that_they_hold_have():
    open_gain = channel_values(np.array([1e4, 4.6]), np.array([7.3e12, 0.2]))
    assert open_gain["gain_ratio"].value is None
    assert open_gain["gain_ratio"].verdict == "sense over drive channel, not determined by these sweeps"
    assert open_gain["phase_asymmetry_deg"].value == 4.6
    sweep = sweep_of(swept(lab.Gyro(), noise=None), RAW)
    held = products((np.array([0.003, 0.0, 2.0, 5.0]), np.array([1e-5, 0.0, 40.0, 0.1])), (sweep,), 2.0)
    assert set(held) == {"gain_ratio*lambda_yx", "gain_ratio*k_xy"}, (
        "the other product is as open, and y was not driven"
    )
    assert held["gain_ratio*k_xy"].value == 10.0


def test_a_value_is_told_with_the_digits_of_its_deviation():
    assert "5999.99987 ± 0.00014" in str(CouplingCoefficient(5999.99987, 0.00014, "Hz", "uncoupled axis"))


def test_result_as_json_and_xarray(wide, tmp_path):
    data = json.loads(wide.to_json())
    assert data["schema"] == "memsgyro-identify/1"
    assert set(data["coefficients"]) == {"lambda_yx", "lambda_xy", "c_xy", "k_xy"}
    assert set(data["coefficients"]["c_xy"]) == {"value", "std", "unit", "verdict"}
    assert data["coefficients"]["c_xy"]["unit"] == "N*s/m"
    assert data["phase_asymmetry_deg"] == pytest.approx(2.4, abs=0.3)
    assert data["chi2_per_dof"] == pytest.approx(1.0, abs=0.08)
    table = kept(wide, tmp_path)
    assert float(table["value"].sel(coefficient="k_xy")) == data["coefficients"]["k_xy"]["value"]
    assert wide.to_pandas().loc["c_xy", "unit"] == "N*s/m"
    left = table["measured"] - table["predicted"]
    assert left.std() < 0.05 * table["measured"].std()


def test_what_was_identified_is_a_device_with_a_joint_uncertainty(wide):
    device, joint = wide.device, wide.uncertainty
    assert [e.label for e in device.effects] == ["force_misalignment x_to_y"], "y was never driven"
    for path, name in {"dxy": "c_xy", "kxy": "k_xy", "effects.force_misalignment_x_to_y.strength": "lambda_yx"}.items():
        place, expected = joint.paths.index(path), wide.coefficients[name]
        assert joint.values[place] == pytest.approx(expected.value, rel=1e-9)
        assert joint.std[place] == pytest.approx(expected.std, rel=1e-9)
    assert float(device.kxy) == pytest.approx(wide.coefficients["k_xy"].value, rel=1e-9)
    assert float(device.mass) == 3e-7
    with pytest.raises(InputError, match="pass `mass` to `identify`"):
        _ = replace(wide, mass=None).device


@pytest.mark.slow
def test_both_electrodes_give_both_force_couplings():
    result = identify([swept(lab.Gyro()), swept(lab.Gyro(), axis=1, seed=1)], noise=RAW, mass=3e-7)
    assert_within(result.coefficients["lambda_yx"], lab.Gyro().lam_yx)
    assert_within(result.coefficients["lambda_xy"], lab.Gyro().lam_xy)
    assert_within(result.coefficients["c_xy"], lab.Gyro().cxy)
    assert result.coefficients["lambda_xy"].verdict == "identified"


@pytest.mark.slow
def test_unknown_noise_is_estimated(wide):
    result = identify([swept(lab.Gyro())], mass=3e-7)
    assert result.chi2_per_dof == pytest.approx(1.0, abs=0.1)
    assert result.coefficients["c_xy"].std == pytest.approx(wide.coefficients["c_xy"].std, rel=0.15)


@pytest.fixture(scope="module")
def unspoilt():
    """A record whose noise is to be estimated, and what is identified from it."""
    right = replace(swept(lab.Gyro()), lines=np.arange(1001) + 2)
    return right, identify([right], mass=3e-7)


@pytest.mark.parametrize(
    ("row", "change", "column"),
    [
        (240, lambda z: -z.conjugate(), "Vy_phase"),
        pytest.param(760, lambda z: 10 * z, "Vy_amp", marks=pytest.mark.slow),
        (0, lambda z: 10 * z, "Vy_amp"),
        pytest.param(1000, lambda z: 1.1 * z, "Vy_amp", marks=pytest.mark.slow),
    ],
)
def test_a_row_with_a_wrong_digit_is_named_and_moves_nothing(row, change, column, unspoilt):
    right, plain = unspoilt
    wrong = replace(right, phasors=right.phasors.copy())
    wrong.phasors[row, 1] = change(wrong.phasors[row, 1])
    found = identify([wrong], mass=3e-7)
    assert not [note for note in plain.notes if "line" in note]
    assert found.notes[0].startswith(f"sweep.csv, line {row + 2}, column `{column}`: the row lies ")
    assert len([note for note in found.notes if "line" in note]) == 1
    assert found.explained
    assert found.repairs == {}
    for name in ("lambda_yx", "c_xy", "k_xy"):
        before, after = plain.coefficients[name], found.coefficients[name]
        assert after.value == pytest.approx(before.value, abs=0.3 * before.std)
        assert after.std == pytest.approx(before.std, rel=0.1)


@pytest.mark.slow
def test_narrow_sweep_is_refused_a_verdict():
    result = identify([swept(lab.Gyro(), lab.NARROW)], noise=RAW, mass=3e-7)
    assert result.explained
    assert result.coefficients["c_xy"].verdict == "not identified by this sweep: sweep both resonances"


def test_noise_free_data_return_the_coefficients():
    device = identify([swept(lab.Gyro(), noise=None)], noise=RAW, mass=3e-7).fit.values.device
    truth = seen_bench().device
    for name in ("damping_coupling", "stiffness_coupling", "force_yx"):
        assert float(getattr(device, name) / getattr(truth, name)) == pytest.approx(1.0, abs=1e-9)


@pytest.mark.slow
def test_too_fast_a_sweep_is_noticed_named_and_repaired():
    fast = swept(SLOW, SLOW_BAND, motion=lab.chirped(SLOW, SLOW_BAND, 1.0))
    plain = identify([fast], noise=RAW, mass=SLOW.mass)
    assert plain.chi2_per_dof > 10 * gate(plain.dof)
    assert plain.coefficients["c_xy"].verdict.endswith("add finite_sweep_rate")
    assert not [note for note in plain.notes if "row" in note], "a misfit that is smooth is no wrong digit"
    repaired = identify([fast], noise=RAW, mass=SLOW.mass, effects=("finite_sweep_rate",))
    assert repaired.explained
    assert_within(repaired.coefficients["c_xy"], SLOW.cxy)
    assert_within(repaired.coefficients["lambda_yx"], SLOW.lam_yx)
    assert_within(repaired.effect_values["sweep_speed"], 1.0)


@pytest.mark.slow
def test_feedthrough_is_noticed_named_and_repaired():
    clean = lab.record(SLOW, INSTRUMENT, SLOW_BAND)
    leak = (0.03 * np.abs(clean[:, 0]).max() * np.exp(1j), 0.02 * np.abs(clean[:, 1]).max())
    leaking = swept(SLOW, SLOW_BAND, instrument=lab.replace(INSTRUMENT, leak=leak))
    plain = identify([leaking], noise=RAW, mass=SLOW.mass)
    assert plain.coefficients["k_xy"].verdict.endswith("add electrical_feedthrough")
    assert not [note for note in plain.notes if "row" in note], "a misfit that is smooth is no wrong digit"
    repaired = identify([leaking], noise=RAW, mass=SLOW.mass, effects=("electrical_feedthrough",))
    assert repaired.explained
    assert_within(repaired.coefficients["c_xy"], SLOW.cxy)
    assert_within(repaired.effect_values["leak_x_I_x_driven"], leak[0].real)


@pytest.mark.slow
def test_a_late_readout_is_noticed_named_and_repaired():
    """A delay of 1 ms turns the phase by 5 deg over the band, which leaks that do not exist explain nearly as well."""
    late = swept(SLOW, SLOW_BAND, noise=lab.FILTERED, motion=None)
    late = replace(late, phasors=late.phasors * np.exp(-1j * late.frequency * 1e-3)[:, None])
    plain = identify([late], mass=SLOW.mass)
    assert "; add readout_delay" in plain.coefficients["c_xy"].verdict
    repaired = identify([late], mass=SLOW.mass, effects=("readout_delay",))
    assert repaired.explained
    assert_within(repaired.effect_values["readout_delay"], 1e-3)
    assert_within(repaired.coefficients["c_xy"], SLOW.cxy)
    assert "not trusted" not in repaired.coefficients["c_xy"].verdict


@pytest.mark.slow
def test_a_device_that_drifts_between_two_sweeps_is_noticed_named_and_repaired():
    """By its springs, all by one share; its damping stays, as the effect has it."""
    up = 1 + 1e-4
    higher = lab.replace(SLOW, fx=SLOW.fx * up, fy=SLOW.fy * up, qx=SLOW.qx * up, qy=SLOW.qy * up, kxy=SLOW.kxy * up**2)
    level = lab.FILTERED
    apart = [swept(SLOW, SLOW_BAND, noise=level), swept(higher, SLOW_BAND, noise=level, axis=1, seed=1)]
    plain = identify(apart, mass=SLOW.mass)
    assert plain.coefficients["c_xy"].verdict.endswith("; add frequency_offset")
    repaired = identify(apart, mass=SLOW.mass, effects=("frequency_offset",))
    assert repaired.explained
    assert_within(repaired.effect_values["frequency_offset_2"], 1e-4)
    assert_within(repaired.coefficients["c_xy"], SLOW.cxy)


class Told:
    """What doubts ask of a fit that leaves so much with so many numbers and tells this c_xy."""

    def __init__(self, chi2, numbers, cxy):
        self.chi2, self.dof, self.chi2_per_dof = chi2, 3200 - numbers, chi2 / (3200 - numbers)
        self.values = SimpleNamespace(couplings=np.array([0.0, 0.0, cxy, 0.0]))
        self.converged, self.open_parameters = True, tuple


LEAKING, LATE, PLAIN = Told(3294.0, 22, 17.7), Told(3257.0, 15, 10.5), Told(7672.0, 14, 17.9)
KNOWN, STD = ("electrical_feedthrough", "readout_delay"), np.full(4, 1.0)


def test_where_two_effects_explain_a_record_the_better_is_named_first_with_both():
    cures = {name: Explanation.of((name,), fit) for name, fit in zip(KNOWN, (LEAKING, LATE), strict=True)}
    told = doubt(PLAIN, (), cures, [], 0.1)
    assert told.endswith("; add readout_delay or electrical_feedthrough (readout_delay does it better)")
    cures["electrical_feedthrough"] = Explanation.of(KNOWN[:1], Told(3199.0, 22, 17.7))
    assert doubt(PLAIN, (), cures, [], 0.1).endswith("(compare what each tells)")


def test_what_another_effect_explains_as_well_is_not_trusted():
    leaking, late = (Explanation.of((name,), fit) for name, fit in zip(KNOWN, (LEAKING, LATE), strict=True))
    (other,) = rivals(leaking, STD, KNOWN, lambda _: LATE)
    told = doubt(LEAKING, (), {}, [other], 0.1)
    assert told == "not trusted: readout_delay explains these sweeps as well or better; compare what each tells"
    assert not rivals(late, STD, KNOWN, lambda _: LEAKING), "leaks take seven numbers more and explain less"
    assert not rivals(leaking, STD, KNOWN, lambda _: Told(3257.0, 15, 17.0)), "both tell the same"
    assert not rivals(Explanation.of((), PLAIN), STD, KNOWN, lambda _: LATE), "nothing was modelled"


@pytest.mark.parametrize(("noise", "level"), [(RAW, lab.RAW), (FILTERED, lab.FILTERED)])
@pytest.mark.slow
def test_many_draws_reach_the_bound(noise, level):
    assert_draws_reach_the_bound(noise, level, draws=1000, tolerance=0.08)


@pytest.mark.slow
def test_some_draws_reach_the_bound():
    assert_draws_reach_the_bound(RAW, lab.RAW, draws=60, tolerance=0.35)


def assert_draws_reach_the_bound(noise, level, draws, tolerance):
    """Spread over draws against the Cramér-Rao bound, χ², coverage."""
    start = seen_bench()
    sweep = sweep_of(swept(lab.Gyro(), noise=None), noise)
    rng = np.random.default_rng(5)
    measured = jnp.stack([lab.noisy(np.asarray(sweep.measured), *level, rng) for _ in range(draws)])

    def couplings(seen):
        device = seen.device
        parts = [device.force_yx, device.damping_coupling, device.stiffness_coupling, seen.readout.phase_asymmetry]
        return jnp.stack(parts)

    fits = eqx.filter_jit(refit_draws)(start, sweep, measured)
    value, std = eqx.filter_jit(jax.vmap(lambda one: (couplings(one.values), one.std_of(couplings))))(fits)
    bound = eqx.filter_jit(lambda at: evaluate(at, free_parameters(at, [sweep]), [sweep]).std_of(couplings))(start)
    assert bool(fits.converged.all())
    np.testing.assert_allclose(np.std(value, axis=0) / bound, 1.0, atol=tolerance)
    assert abs(float(jnp.mean(fits.chi2_per_dof)) - 1) < 0.02
    cover = np.mean(np.abs(value - couplings(start)) < 1.96 * std)
    assert 0.93 < cover < 0.97
    assert float(jnp.rad2deg(bound[3])) < 0.06


@pytest.mark.slow
@pytest.mark.parametrize("count", [4, 200])
def test_naive_starts_reach_the_optimum_found_from_the_truth(count):
    rng = np.random.default_rng(17)
    reached = 0
    for _ in range(count):
        gyro, instrument, band = random_device(rng)
        sweep = sweep_of(swept(gyro, band, seed=rng.integers(2**31), instrument=instrument), RAW)
        best = float(refit(seen_bench(gyro, instrument), (sweep,)).chi2)
        reached += float(fit_sweeps((sweep,), leak=False, moving=False).chi2) <= best + 0.05
    assert reached >= 0.97 * count


def random_device(rng):
    """Q 1e3-1e5, split 5 Hz-1 kHz, gain ratio 0.2-5, phase ±60°; a sweep that is dense where the resonances are."""
    between = lambda low, high: np.exp(rng.uniform(np.log(low), np.log(high)))  # noqa: E731
    fx, split, m = between(3e3, 3e4), between(5, 1000) * rng.choice([-1, 1]), 3e-7
    qx, qy = between(1e3, 1e5), between(1e3, 1e5)
    wx, wy = 2 * np.pi * fx, 2 * np.pi * (fx + split)
    coupling = between(1e-3, 0.5) * abs(wy - wx) * 2 * wx * rng.choice([-1, 1])
    gyro = lab.Gyro(
        m, fx, fx + split, qx, qy, m * rng.uniform(-0.5, 0.5) * np.sqrt(wx * wy / qx / qy), m * coupling,
        between(1e-4, 0.1) * rng.choice([-1, 1]), 0.0,
    )  # fmt: skip
    instrument = lab.Instrument(
        1e9 * np.exp(1j * rng.uniform(-3, 3)), between(0.2, 5), np.radians(rng.uniform(-60, 60))
    )
    widths = [fx / qx, (fx + split) / qy]
    margin = max(0.3 * abs(split), 5 * max(widths))
    grids = [np.linspace(min(fx, fx + split) - margin, max(fx, fx + split) + margin, 601)]
    grids += [f + w * np.sinh(np.linspace(-3, 3, 200)) for f, w in zip((fx, fx + split), widths, strict=True)]
    return gyro, instrument, np.sort(np.concatenate(grids))


def test_the_gauge_twin_predicts_the_same():
    seen = seen_bench(instrument=lab.replace(INSTRUMENT, asymmetry=np.radians(140)))
    turned = gauge_fixed(seen)
    sweep = FrequencySweep("gauge", 2 * np.pi * lab.WIDE, np.ones((1001, 2)) + 0j, RAW, axis=1)
    assert abs(float(turned.readout.phase_asymmetry)) < np.pi / 2
    np.testing.assert_allclose(sweep.predict(turned), sweep.predict(seen), rtol=1e-12)
    assert float(turned.device.damping_coupling) == pytest.approx(-float(seen.device.damping_coupling), rel=1e-9)


@pytest.mark.slow
def test_the_estimate_is_differentiable_by_the_data():
    start, clean = seen_bench(), sweep_of(swept(lab.Gyro(), noise=None), RAW)

    def damping(errors):
        phase, slant = errors
        turn = phase * jnp.array([0.0, 1.0]) + slant * jnp.linspace(0, 1, 1001)[:, None]
        turned = clean.with_measured(clean.measured * jnp.exp(1j * turn))
        return refit(start, (turned,), tolerance=1e-9).values.device.damping_coupling

    @jax.jit
    def along(errors, direction):  # one program for every value and slope
        return jax.jvp(damping, (errors,), (direction,))

    none, phase, slant = jnp.zeros(2), jnp.array([1.0, 0.0]), jnp.array([0.0, 1.0])
    # An error of the phase between the channels is a nuisance of this estimator: the coefficient must not follow it.
    value, slope = along(none, phase)
    assert abs(float(slope / value)) < 1e-6
    _, slope = along(none, slant)
    step = 1e-5
    difference = (along(step * slant, slant)[0] - along(-step * slant, slant)[0]) / (2 * step)
    assert float(slope) == pytest.approx(float(difference), rel=1e-3)


@pytest.mark.slow
def test_the_published_chain_runs_and_is_worse():
    records = [
        swept(lab.Gyro(), noise=lab.FILTERED, axis=axis, instrument=lab.replace(INSTRUMENT, drive_ratio=1.0))
        for axis in (0, 1)
    ]
    result = identify_by_ratio(records, noise=FILTERED, mass=3e-7)
    assert abs(result.coefficients["c_xy"].value / lab.Gyro().cxy - 1) > 1.0
    assert result.coefficients["k_xy"].value == pytest.approx(0.103, rel=0.2)
    assert json.loads(result.to_json())["method"].startswith("ratio")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"records": []}, "at least one sweep"),
        ({"effects": ("duffing",)}, "electrical_feedthrough"),
        ({"mass": -1.0}, "positive number of kilograms"),
        ({"effects": ("frequency_offset",)}, "must have two sweeps to lie between, but there is one"),
    ],
)
def test_bad_arguments_are_one_sentence(arguments, message):
    with pytest.raises(InputError, match=message):
        identify(**{"records": [swept(lab.Gyro())], **arguments})


def test_ratio_method_needs_both_resonances():
    with pytest.raises(InputError, match="sweep both resonances"):
        identify_by_ratio([swept(lab.Gyro(), lab.NARROW, noise=None)])


@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (1, 2))])
@pytest.mark.parametrize("wrong", [-1.0, 10.0, 0.1])
def test_ratio_method_names_a_row_with_a_wrong_sign_or_digit(wrong, seed):
    right = swept(lab.Gyro(), noise=lab.FILTERED, seed=seed)
    row = int(
        np.random.default_rng(seed).choice(
            np.flatnonzero(np.abs(right.phasors[:, 0]) > 0.05 * np.abs(right.phasors[:, 0]).max())
        )
    )
    phasors = right.phasors.copy()
    phasors[row, 0] *= wrong
    clean, spoilt = (identify_by_ratio([sweep], mass=3e-7) for sweep in (right, replace(right, phasors=phasors)))
    assert not any("stands alone" in note for note in clean.notes)
    assert [note for note in spoilt.notes if f"row {row + 1}: the row stands alone" in note]
    for name in ("lambda_yx", "c_xy", "k_xy"):
        assert abs(spoilt.coefficients[name].value - clean.coefficients[name].value) < clean.coefficients[name].std
