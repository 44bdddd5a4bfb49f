"""Sweeps at several temperatures or bias voltages of a resonance that moves by many of its widths between them.

The records are closed forms of an oscillator, written here. All of these ended as an unknown effect, with quality
factors up to 1e14, as the one base model of all settings had no valley to the truth.
"""

from dataclasses import replace

import numpy as np
import pytest

import memsgyro_jax as mg
from memsgyro_jax.diagnosis.identifiable import identifiable
from memsgyro_jax.diagnosis.joint_residual import Joint
from memsgyro_jax.diagnosis.odd_setting import odd_setting
from memsgyro_jax.diagnosis.optimum import optimise
from memsgyro_jax.diagnosis.settings_apart import as_many_as_settings, begun, in_each_place
from memsgyro_jax.diagnosis.settings_table import settings_table
from memsgyro_jax.diagnosis.valley import to_its_end
from memsgyro_jax.diagnosis.worth_trying import worth_trying
from memsgyro_jax.effects import catalogue
from memsgyro_jax.measurement.beside_design import beside_design
from memsgyro_jax.measurement.linear_start import starting_device
from memsgyro_jax.measurement.one_place import nearest_in_words, place_in_words
from memsgyro_jax.measurement.readings import model_of, readings_of


TURN = 2.0 * np.pi
HEAD = """schema = "memsgyro-case/1"
name = "{name}"
device = "resonator"

[readout]
quantity = "{quantity}"

[environment]
temperature = {{ value = 25, unit = "degC" }}
bias_voltage = {{ value = {bias}, unit = "V" }}

[design]
"""
RECORD = """
[[experiment]]
name = "{name}"
kind = "frequency_sweep"
file = "{name}.csv"
"""


def recorded(folder, name, rows, noise, seed=0, bias=0.0, quantity="displacement", apart=False):
    """The case of rows of temperature [degC], bias [V], drive [V], frequency [Hz] and voltage; `apart` makes a record
    of each temperature.
    """
    rng, head = np.random.default_rng(seed), "T [degC],V_bias [V],F_x [V],f [Hz],Vx_I [V],Vx_Q [V]"
    files = {}
    for temperature, volts, drive, hertz, seen in rows:
        seen = seen + noise * complex(*rng.standard_normal(2))
        told = ",".join(f"{value:.12g}" for value in (temperature, volts, drive, hertz, seen.real, seen.imag))
        files.setdefault(f"at_{temperature:g}" if apart else "sweeps", [head]).append(told)
    for file, lines in files.items():
        (folder / f"{file}.csv").write_text("\n".join(lines) + "\n")
    text = HEAD.format(name=name, bias=bias, quantity=quantity) + "".join(RECORD.format(name=file) for file in files)
    (folder / "case.toml").write_text(text)
    return mg.load_case(folder)


@pytest.fixture
def oven(tmp_path):
    """A fork of 32 768 Hz, Q 1e5: −30 ppm/K move it by 90 widths from −40 to 85 °C."""
    rows, drive = [], 1e-3
    for temperature in (-40.0, -10.0, 25.0, 55.0, 85.0):
        square = (TURN * 32768.0) ** 2 * (1 - 6e-5 * (temperature - 25.0))
        damping = TURN * 0.32768 * (1 + 2e-3 * (temperature - 25.0))
        for hertz in np.sqrt(square) / TURN + np.linspace(-2.0, 2.0, 61):
            omega = TURN * hertz
            rows.append((temperature, 0.0, drive, hertz, 7e7 * drive / (square - omega**2 + 1j * omega * damping)))
    return recorded(tmp_path, "oven", rows, 2.0e-4)


@pytest.fixture
def crossed(tmp_path):
    """At 150 kHz, three settings of temperature and bias together, of a stiffness whose course with the temperature
    bends and that no bias softens.
    """
    rows = []
    for temperature, bias in ((25.0, 10.0), (45.0, 15.0), (65.0, 20.0)):
        warm = temperature - 25.0
        square = (TURN * 1.5e5) ** 2 * (1 - 6e-5 * warm - 4e-7 * warm**2)
        for hertz in np.sqrt(square) / TURN + np.linspace(-24.0, 24.0, 61):
            omega = TURN * hertz
            rows.append((temperature, bias, 1e-3, hertz, 1e6 / (square - omega**2 + 1j * omega * TURN * 6.0)))
    return recorded(tmp_path, "crossed", rows, 2e-9, bias=10.0)


@pytest.fixture
def electrodes(tmp_path):
    """A comb of 62 kHz at five bias voltages, of which it gives force and sees current in proportion."""
    mass, spring, softens = 2.1e-10, 2.1e-10 * (TURN * 62310.0) ** 2, 1.9e-4
    rows, drive = [], 1e-3
    for bias in (6.0, 8.0, 10.0, 13.0, 16.0):
        stiffness = spring - softens * bias**2
        for hertz in np.sqrt(stiffness / mass) / TURN + np.linspace(-30.0, 30.0, 81):
            omega = TURN * hertz
            motion = 3.1e-8 * bias * drive / (stiffness - mass * omega**2 + 1j * omega * mass * TURN * 7.6)
            rows.append((25.0, bias, drive, hertz, 4e6 * 3.1e-8 * bias * 1j * omega * motion))
    return recorded(tmp_path, "electrodes", rows, 1e-5, bias=6.0, quantity="velocity")


@pytest.fixture
def hot(tmp_path):
    """A spring that hardens, at three temperatures and two drives, the higher of which bends it over by three widths;
    swept upwards.
    """
    rows, gain, hardens = [], 3e9, 3e17
    for temperature in (-20.0, 25.0, 80.0):
        square = (TURN * 1.02e5) ** 2 * (1 - 4.8e-5 * (temperature - 25.0))
        damping = TURN * 5.1 * (1 + 1e-3 * (temperature - 25.0))
        for drive, ends, count in ((2e-8, (-12.0, 12.0), 81), (1.6e-7, (-12.0, 35.0), 141)):
            before = 0.0
            for hertz in np.sqrt(square) / TURN + np.linspace(*ends, count):
                omega, bend = TURN * hertz, 0.75 * hardens
                off = square - omega**2
                roots = np.roots([bend**2, 2 * bend * off, off**2 + (omega * damping) ** 2, -((gain * drive) ** 2)])
                real = roots[np.abs(roots.imag) < 1e-9 * np.abs(roots.real)].real
                before = real[np.argmin(np.abs(real - before))]
                rows.append(
                    (temperature, 0.0, drive, hertz, gain * drive / (off + bend * before + 1j * omega * damping))
                )
    return recorded(tmp_path, "hot", rows, 6e-9)


def found_start(case, *names):
    """The device that a fit begins with, and absent effects of these names, or of all."""
    effects = [effect for effect in catalogue(1) if not names or effect.name in names]
    return model_of(case, starting_device(case)).with_effect(*effects)


def found_in(case):
    model = found_start(case)
    joint = Joint(model, readings_of(case))
    vector, places = begun(joint, in_each_place(case), range(len(model.effects)))
    return {model.effects[i].label: vector[joint.of_effect(i)].item() for i in places}


def test_amplitudes_alone_tell_it_too(oven):
    sizes = replace(oven.records[0], phasors=np.abs(oven.records[0].phasors) + 0j, phase_known=False)
    found = found_in(replace(oven, records=(sizes,)))
    assert found["thermal_drift stiffness"] == pytest.approx(-6e-5, rel=1e-4)


def test_a_table_shows_each_of_the_surroundings(oven, electrodes):
    head, *rows = settings_table(oven).splitlines()
    assert head.split() == ["T", "[°C]", "resonance", "[Hz]", "moved", "[ppm]", "quality", "factor", "gain"]
    assert [row.split()[0] for row in rows] == ["-40", "-10", "25", "55", "85"]
    assert rows[2].split()[1] == "32768.000"
    assert float(rows[4].split()[2]) == pytest.approx(1e6 * (np.sqrt((1 - 6e-5 * 60) / (1 + 6e-5 * 65)) - 1), abs=1.0)
    assert float(rows[0].split()[3]) == pytest.approx(1e5 * np.sqrt(1 + 6e-5 * 65) / (1 - 2e-3 * 65), rel=5e-3)
    assert float(settings_table(electrodes).split()[-1]) == pytest.approx(7.11, abs=0.02)
    assert settings_table(replace(oven, records=())) == ""


def test_a_table_has_no_digits_that_noise_makes(oven):
    """A quality factor stood there with four digits where the third was noise."""
    record, rng = oven.records[0], np.random.default_rng(4)
    noise = 3e-2 * np.abs(record.phasors).max() * (rng.normal(size=(2, *record.phasors.shape)))
    noisy = replace(record, phasors=record.phasors + noise[0] + 1j * noise[1])
    plain, rows = (
        settings_table(oven).splitlines()[1:],
        settings_table(replace(oven, records=(noisy,))).splitlines()[1:],
    )
    for row, true in zip(rows, plain, strict=True):
        value, std = (float(word) for word in row.split(" ± ")[0].split()[-1:] + row.split(" ± ")[1].split()[:1])
        assert abs(value - float(true.split()[3])) < 5.0 * std
        assert value % 10 ** np.floor(np.log10(std)) == 0.0


def test_the_surroundings_of_a_device_are_told(oven, electrodes):
    elsewhere = replace(oven.environment, temperature=310.0)
    assert place_in_words(oven.environment, oven.records) == "25 °C"
    assert place_in_words(elsewhere, oven.records) == "36.85 °C, where no record was taken"
    assert place_in_words(electrodes.environment, electrodes.records) == "6 V"
    assert nearest_in_words(elsewhere, oven.records) == "25 °C"


def test_as_many_strengths_as_settings_bear_nothing_out(crossed, electrodes):
    """Both strengths were told to 0.03 % and nothing doubted, where one is none at all."""
    for case, loose in ((crossed, {"thermal_drift stiffness", "electrostatic_softening x"}), (electrodes, set())):
        model = found_start(case, "thermal_drift", "electrostatic_softening", "bias_transduction")
        joint, every = Joint(model, readings_of(case)), in_each_place(case)
        wanted = {"thermal_drift stiffness", "electrostatic_softening x", "bias_transduction drive"}
        places = [i for i, effect in enumerate(model.effects) if effect.label in wanted]
        assert {model.effects[i].label for i in as_many_as_settings(joint, every, places)} == loose
        assert as_many_as_settings(joint, [], places) == set(), "no sweeps"


def test_one_setting_that_was_written_down_wrongly_is_named(electrodes):
    """12 V for 13: all others agree."""
    record = electrodes.records[0]
    wrong = replace(record, bias_voltage=np.where(record.bias_voltage == 13.0, 12.0, record.bias_voltage))
    said = odd_setting(replace(electrodes, records=(wrong,)))
    assert said.startswith("without what was taken at 25 °C and 12 V all others go with ")
    assert "electrostatic_softening x" in said
    assert "bias_transduction drive" in said
    assert odd_setting(electrodes) == ""


def test_gains_that_go_with_the_temperature_are_tried_from_four_on(oven):
    names = {effect.label for effect in worth_trying(oven)}
    assert {"thermal_drift pickoff_gain", "thermal_drift drive_gain"} <= names
    assert "thermal_drift bias_voltage" not in names


def test_a_course_that_bends_is_tried_from_four_temperatures(oven):
    def labels(case):
        return {effect.name for effect in worth_trying(case)}

    few = oven.records[0].only(oven.records[0].temperature < 310.0)
    assert "thermal_curvature" in labels(oven)
    assert "thermal_curvature" not in labels(replace(oven, records=(few,)))


def test_settings_tell_what_moved_the_device(oven):
    found = found_in(oven)
    assert list(found) == ["thermal_drift stiffness", "thermal_drift damping"]
    assert found["thermal_drift stiffness"] == pytest.approx(-6e-5, rel=1e-4)
    assert found["thermal_drift damping"] == pytest.approx(2e-3, rel=0.05)


def test_a_gain_that_goes_with_the_bias_is_told_beside_the_spring(electrodes):
    found = found_in(electrodes)
    assert set(found) == {"electrostatic_softening x", "bias_transduction drive"}
    assert found["bias_transduction drive"] == pytest.approx(2.0, abs=2e-3)


def test_what_is_checked_is_the_device_in_one_place(oven):
    said = beside_design(oven)
    assert said[0] == "resonance: the records show 32.768 kHz."
    assert 9.9e4 < float(said[1].split()[-1].rstrip(".")) < 1.01e5
    assert len(said) == 2, "no phase"
    assert identifiable(oven)[0].relative[1] < 2e-3


def test_a_fit_finds_its_valley(oven):
    with_drift = [e for e in catalogue(1) if e.name == "thermal_drift"]
    found = mg.fit(None, oven, effects=with_drift)
    assert found.chi2_per_dof < 1.2
    told = {estimate.name: estimate for estimate in found.estimates}
    for name, true in (("thermal_drift stiffness", -6e-5), ("thermal_drift damping", 2e-3)):
        assert abs(told[name].value - true) < 4 * told[name].std


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "effects"),
    [
        ("oven", {"thermal_drift stiffness": -6e-5, "thermal_drift damping": 2e-3}),
        ("hot", {"thermal_drift stiffness": -4.8e-5, "thermal_drift damping": 1e-3, "cubic_stiffness x": 1e8}),
        ("electrodes", {"electrostatic_softening x": None, "bias_transduction drive": 2.0}),
    ],
)
def test_a_diagnosis_names_what_moves_it(name, effects, request):
    found = mg.diagnose(None, request.getfixturevalue(name))
    assert found.verdict == ("cannot_tell" if name == "electrodes" else "found")
    assert {a.label for a in found.accepted} == {*effects}
    for a in found.accepted:
        true = effects[a.label]
        assert true is None or abs(a.estimate[0] - true) < 4 * a.std[0]
    if name == "electrodes":
        assert ("bias_transduction drive", "bias_transduction pickoff") in found.groups


def test_a_fit_that_has_not_converged_goes_on(oven):
    """It stopped after 30 evaluations whatever was left to gain."""
    joint = Joint(found_start(oven, "thermal_drift"), readings_of(oven))
    vector, _ = begun(joint, in_each_place(oven), range(2))
    vector[:2] *= 1.000005, 3.0
    stopped = optimise(joint, vector, np.arange(vector.size), joint.fitted, max_evaluations=2)
    assert not stopped.converged
    ended = to_its_end(joint, stopped)
    assert ended.converged
    assert ended.chi2 < stopped.chi2
    assert ended.evaluations > stopped.evaluations


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2, 7])
def test_a_damping_of_no_known_law_is_no_slow_noise(tmp_path, seed):
    """With the cube of the absolute temperature, at too few of them for a course that bends: "found", and the misfit of
    each resonance noise that is slow.
    """
    rows = []
    for temperature in (-10.0, 30.0, 70.0):
        square = 6e4**2 * (1 - 5.8e-5 * (temperature - 25.0))
        width = 5.0 * ((temperature + 273.15) / 298.15) ** 3
        for hertz in np.sqrt(square) + np.linspace(-30.0, 30.0, 121):
            rows.append((temperature, 0.0, 5e-3, hertz, 3e4 / (square - hertz**2 + 1j * hertz * width)))
    found = mg.diagnose(None, recorded(tmp_path, "cube", rows, 2e-4, seed=seed, apart=True))
    assert found.verdict == "partly_explained"
    assert "noise is not white" not in found.sentence
    assert {a.label for a in found.accepted} == {"thermal_drift stiffness", "thermal_drift damping"}


def decays(folder, noise=2e-4):
    """Phasors of a ring-down at three temperatures, as an oven and a lock-in make them: 9137 Hz, Q 12 000."""
    rng, time = np.random.default_rng(5), np.arange(1200) * 1e-3
    text = HEAD.format(name="ringing", bias=0, quantity="displacement")
    text += 'resonance = { value = 9137, tolerance = 0.1, unit = "Hz" }\n'
    text += 'quality_factor = { value = 12000, tolerance = 0.9, unit = "1" }\n'
    for celsius in (-20, 25, 70):
        hertz, damping = 9137 * np.sqrt(1 - 6e-5 * (celsius - 25)), TURN * 9137 / 12e3 * (1 + 3e-3 * (celsius - 25))
        turn = np.exp(-damping / 2 * time + 1j * TURN * (np.sqrt(hertz**2 - (damping / 2 / TURN) ** 2) - 9137) * time)
        seen = 0.8 * turn + noise * (rng.standard_normal(time.size) + 1j * rng.standard_normal(time.size))
        rows = np.column_stack([time, np.full(time.size, celsius), seen.real, seen.imag])
        np.savetxt(
            folder / f"r{celsius}.csv", rows, "%.9g", ",", header="t [s],T [degC],Vx_I [V],Vx_Q [V]", comments=""
        )
        text += RECORD.format(name=f"r{celsius}").replace("frequency_sweep", "free_decay")
        text += 'reference_frequency = { value = 9137, unit = "Hz" }\n'
    (folder / "case.toml").write_text(text)
    return mg.load_case(folder)


def test_each_decay_shows_the_device_at_its_temperature(tmp_path):
    case = decays(tmp_path)
    every = in_each_place(case)
    assert [one.temperature for one in every] == pytest.approx([253.15, 298.15, 343.15])
    hertz = np.sqrt([one.stiffness for one in every]) / TURN
    np.testing.assert_allclose(hertz, 9137 * np.sqrt(1 - 6e-5 * np.array([-45, 0, 45])), rtol=3e-7)
    np.testing.assert_allclose(
        [one.damping for one in every], TURN * 9137 / 12e3 * np.array([0.865, 1, 1.135]), rtol=5e-3
    )
    assert np.isnan([one.gain for one in every]).all()
    table = settings_table(case)
    assert "gain" not in table
    assert "9149.32" in table
    joint = Joint(model_of(case, starting_device(case)).with_effect(*worth_trying(case)), readings_of(case))
    vector, chosen = begun(joint, every, range(len(joint.model.effects)))
    assert [joint.model.effects[i].label for i in chosen] == ["thermal_drift stiffness", "thermal_drift damping"]
    strengths = [float(vector[joint.of_effect(i)][0]) for i in chosen]
    np.testing.assert_allclose(strengths, [-6e-5, 3e-3], rtol=2e-2)


@pytest.mark.slow
def test_decays_in_an_oven_are_explained(tmp_path):
    """The drift was no effect of a record over time, and none of them could be explained beside the others."""
    result = mg.diagnose(None, decays(tmp_path))
    assert result.verdict == "found"
    found = {one.label: (one.estimate[0], one.std[0]) for one in result.accepted}
    assert set(found) == {"thermal_drift stiffness", "thermal_drift damping"}
    for label, truth in (("thermal_drift stiffness", -6e-5), ("thermal_drift damping", 3e-3)):
        value, std = found[label]
        assert abs(value - truth) < 4 * std < 1e-2 * abs(truth)
