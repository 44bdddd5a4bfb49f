"""A lock-in that sees the read-out late: of a linear device, made by other code, and of one that bends over."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from lab import bent

import memsgyro_jax as mg
from memsgyro_jax.diagnosis.fewer import as_a_phase, imitated, take_out
from memsgyro_jax.diagnosis.instrument import instrument_terms
from memsgyro_jax.diagnosis.joint_residual import Joint
from memsgyro_jax.diagnosis.search import start_search
from memsgyro_jax.effects import by_name, catalogue
from memsgyro_jax.measurement.linear_start import starting_device
from memsgyro_jax.measurement.readings import model_of, readings_of


F0, Q, MASS, SCALE, FORCE, NOISE = 41.3e3, 700.0, 3e-9, 2e5, 1e-7, 2e-6  # Hz, 1, kg, V/m, N, V
CASE = f"""schema = "memsgyro-case/1"
name = "late"
device = "resonator"
[readout]
scale = {{ value = {SCALE}, unit = "V/m" }}
[design]
mass = {{ value = {MASS}, unit = "kg", tolerance = 0.1 }}
resonance = {{ value = 41.2, unit = "kHz", tolerance = 0.01 }}
[[experiment]]
name = "sweep"
kind = "frequency_sweep"
file = "sweep.csv"
settled = true
drive_force = {{ value = {FORCE}, unit = "N" }}
drive_axis = "x"
noise_std = "{NOISE} V"
"""


def swept(folder, delay, phase=0.0, leak=0.0):
    """The case of one sweep over 600 Hz."""
    rng, frequency = np.random.default_rng(5), F0 + np.linspace(-300.0, 300.0, 61)
    omega, natural = 2.0 * np.pi * frequency, 2.0 * np.pi * F0
    moved = FORCE / MASS / (natural**2 - omega**2 + 1j * omega * natural / Q)
    volts = (SCALE * moved + leak * FORCE) * np.exp(1j * phase - 1j * omega * delay)
    volts += NOISE * (rng.standard_normal(61) + 1j * rng.standard_normal(61))
    np.savetxt(folder / "sweep.csv", np.column_stack([frequency, volts.real, volts.imag]), "%.15g", ",",
               header="f [Hz],Vx_I [V],Vx_Q [V]", comments="")  # fmt: skip
    (folder / "case.toml").write_text(CASE)
    return mg.load_case(folder)


@pytest.mark.slow
@pytest.mark.parametrize(("delay", "leak"), [(4e-3, 0.0), (4e-3, 3000.0 - 2000.0j), (-2.5e-3, 3000.0)])
def test_many_periods_late_and_a_leak_are_the_instrument(tmp_path, delay, leak):
    """Turned by 15 rad over the band, as behind 50 ns of cable at 7.9 GHz: it was an unknown effect."""
    found = mg.diagnose(None, swept(tmp_path, delay, 0.4, leak))
    assert (found.verdict, found.accepted) == ("instrument_only", ())
    told = {term.label: term for term in found.instrument}
    late = told["late_readings"]
    assert abs(late.estimate[0] - delay) < 4 * late.std[0] < 0.02 * abs(delay)
    quality = next(mode for mode in found.final.modes if mode.name == "quality factor")
    assert abs(quality.value - Q) < 4 * quality.std < 0.05 * Q


@pytest.mark.parametrize(
    ("delay", "phase", "leak", "kept"),
    [
        (9e-6, 0.0, 0.0, {"readout_delay"}),
        (9e-6, 0.4, 0.0, {"readout_delay", "reference_phase"}),
        (0.0, 0.4, 0.0, {"reference_phase"}),
        (0.0, 0.4, 900.0 + 900.0j, {"reference_phase", "lock_in_feedthrough"}),
    ],
)
def test_a_delay_is_told_from_a_phase_and_a_part_of_the_drive(tmp_path, delay, phase, leak, kept):
    """Of 2.3 rad at the resonance and 0.034 rad over the band, which looks like a part of the drive."""
    case = swept(tmp_path, delay, phase, leak)
    terms = [t for t in instrument_terms(case) if t.label in ("reference_phase", "lock_in_feedthrough")]
    late = by_name("readout_delay", among=catalogue(1))
    joint = Joint(model_of(case, starting_device(case)).with_effect(*terms, late), readings_of(case))
    joint.together(range(3))
    search = start_search(case, joint, 0.045, (0, 1), lambda text: None)
    imitated(search)
    take_out(search)
    found = [*search.given, *search.accepted]
    assert {joint.model.effects[i].label for i in found} == kept
    assert search.optimum.chi2 < 1.6 * search.optimum.dof
    (told,) = search.optimum.vector[joint.of_effect(2)]
    std = dict(zip(search.optimum.free.tolist(), search.optimum.std, strict=True)).get(joint.of_effect(2)[0], 0.0)
    assert abs(told - delay) <= 4.0 * std
    if "reference_phase" in kept:
        assert search.optimum.vector[joint.of_effect(0)] == pytest.approx(phase, abs=0.03)


@pytest.mark.slow
@pytest.mark.parametrize(("delay", "phase", "kept"), [(0.0, -0.4, "reference_phase"), (9e-6, 0.0, "readout_delay")])
def test_a_delay_that_may_be_a_phase_is_called_one(tmp_path, delay, phase, kept):
    """Found as an effect of the device, it would be quoted with the precision of a phase."""
    case = swept(tmp_path, delay, phase)
    late = by_name("readout_delay", among=catalogue(1))
    start = eqx.tree_at(lambda effect: effect.strength, late, jnp.array(delay or 0.4 / (2 * np.pi * F0)))
    joint = Joint(model_of(case, starting_device(case)).with_effect(start), readings_of(case))
    search = start_search(case, joint, 0.045, (0,), lambda text: None)
    search.given, search.accepted = (), [0]
    found = as_a_phase(search)
    assert [found.joint.model.effects[i].label for i in (*found.given, *found.accepted)] == [kept]
    assert found.optimum.chi2 < 1.6 * found.optimum.dof
    if phase:
        (place,) = found.joint.of_effect(found.given[0])
        assert found.optimum.vector[place] == pytest.approx(phase, abs=3e-3)
        assert found.steps[-1].added == "reference_phase in place of readout_delay"


@pytest.mark.slow
def test_a_phase_alone_is_no_climb(tmp_path):
    """A linear device at two drives: nothing was left beside the lock-in, and a share of it was asked for."""
    swept(tmp_path, 0.0, 0.4)
    table = np.loadtxt(tmp_path / "sweep.csv", delimiter=",", skiprows=1)
    rng = np.random.default_rng(6)
    table[:, 1:] = 3.0 * table[:, 1:] + 3.0 * NOISE * rng.standard_normal((61, 2))
    np.savetxt(tmp_path / "more.csv", table, "%.15g", ",", header="f [Hz],Vx_I [V],Vx_Q [V]", comments="")
    (_, sweep), new = CASE.split("[[experiment]]"), {'"sweep': '"more', f"value = {FORCE}": f"value = {3.0 * FORCE}"}
    for old, more in (*new.items(), (f"{NOISE} V", f"{np.sqrt(18.0) * NOISE} V")):
        sweep = sweep.replace(old, more)
    (tmp_path / "case.toml").write_text(f"{CASE}[[experiment]]{sweep}")
    found = mg.diagnose(None, mg.load_case(tmp_path))
    assert (found.verdict, [term.label for term in found.instrument]) == ("instrument_only", ["reference_phase"])
    assert found.instrument[0].estimate[0] == pytest.approx(0.4, abs=1e-3)


@pytest.mark.slow
@pytest.mark.parametrize(("delay", "phase"), [(18e-6, 0.0), (18e-6, 0.5), (0.0, 0.5)])
def test_a_spring_is_found_beside_a_late_lock_in(tmp_path, delay, phase):
    """Of 2.6 rad at the resonance: it was taken for a phase and a part in proportion to the drive."""
    folder = bent.bent_sweeps(tmp_path / "case", (5, 20, 60), phase=phase, delay=delay)
    found = mg.diagnose(None, mg.load_case(folder))
    assert found.verdict == "found", found.sentence
    strengths = {effect.label: (effect.estimate[0], effect.std[0]) for effect in found.accepted}
    assert set(strengths) == {"cubic_stiffness x"} | ({"readout_delay"} if delay else set())
    assert strengths["cubic_stiffness x"][0] == pytest.approx(bent.CUBIC, rel=1e-3)
    told, std = strengths.get("readout_delay", (0.0, 0.0))
    assert abs(told - delay) <= 4.0 * std
    assert [term.label for term in found.instrument] == (["reference_phase"] if phase else [])
