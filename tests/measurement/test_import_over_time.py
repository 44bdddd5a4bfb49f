"""What a lock-in with two demodulators records over time becomes a free decay of two axes, or a rate table."""

import re
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.signal import lfilter

import memsgyro_jax as mg
from memsgyro_jax.base.errors import InputError
from memsgyro_jax.device.normalised import NormalisedDevice
from memsgyro_jax.measurement.case import load_case, write_case
from memsgyro_jax.measurement.case_of_records import _design
from memsgyro_jax.measurement.column_map import parse_map
from memsgyro_jax.measurement.column_meaning import meaning_of
from memsgyro_jax.measurement.formats import read_instrument_file
from memsgyro_jax.measurement.readings import model_of, readings_of
from memsgyro_jax.measurement.tracking import rough_decay


REFERENCE = 8050.0
HEADER = "Time (s);{}Demod 1 X (V);Demod 1 Y (V);Demod 2 X (V);Demod 2 Y (V)"


def wrote(path, time, phasors, rate=None, drive=None):
    """As a lock-in that streams its samples saves them."""
    between = [column for column in (rate, drive) if column is not None]
    table = np.column_stack(
        [time, *between, phasors[:, 0].real, phasors[:, 0].imag, phasors[:, 1].real, phasors[:, 1].imag]
    )
    header = HEADER.format(("" if rate is None else "Rate (deg/s);") + ("" if drive is None else "Drive (mV);"))
    path.write_text("\n".join([header, *(";".join(f"{v:.12g}" for v in row) for row in table)]) + "\n")
    return path


def swept(path, sign=1):
    """A sweep of x, whose phase falls across the resonance, or rises."""
    f = np.linspace(7950.0, 8150.0, 81)
    answer = 1e6 / (8050.0**2 - f**2 + 1j * f * 20.0)
    noise = 1e-4 * np.random.default_rng(1).normal(size=(4, f.size))
    x, y = answer + noise[0] + 1j * noise[1], 0.02 * answer + noise[2] + 1j * noise[3]
    lines = np.column_stack([f, x.real, sign * x.imag, y.real, sign * y.imag])
    header = HEADER.format("").replace("Time (s)", "Frequency (Hz)")
    path.write_text("\n".join([header, *(";".join(f"{v:.12g}" for v in row) for row in lines)]) + "\n")
    return path


def decayed(time):
    turning = np.exp((2j * np.pi * 3.0 - 60.0) * time)[:, None] * np.array([0.05 + 0.02j, 0.004j])
    return turning + 1e-5 * np.random.default_rng(2).normal(size=turning.shape)


def test_two_demodulators_over_time_are_a_free_decay_of_two_axes(tmp_path):
    time = np.arange(200) * 5e-4
    files = [swept(tmp_path / "drive_x_10mV.csv"), wrote(tmp_path / "ringdown.csv", time, decayed(time))]
    found = mg.import_case(files, tmp_path / "case", reference=f"{REFERENCE} Hz")
    sweep, decay = found.case.records
    assert (found.case.device, sweep.kind, decay.kind) == ("single_mass", "frequency_sweep", "free_decay")
    np.testing.assert_allclose(decay.signals, decayed(time), rtol=1e-9)
    assert decay.reference_frequency == pytest.approx(2 * np.pi * REFERENCE)


@pytest.mark.parametrize("sign", [1, -1])
def test_rates_beside_two_demodulators_are_a_rate_table(sign, tmp_path):
    """Phasors of files that follow e^{-iωt}, as their sweeps show, are negated in both."""
    block = 80 / REFERENCE
    time, rate = (np.arange(120) + 0.5) * block, np.repeat([0.0, 50.0, -50.0], 40)
    phasors = np.stack([np.full(120, 0.05 + 0.01j), (2e-3 + 1e-5 * rate) * 1j], axis=1)
    seen = phasors if sign > 0 else phasors.conj()
    files = [swept(tmp_path / "drive_x_10mV.csv", sign), wrote(tmp_path / "table_drive_x.csv", time, seen, rate)]
    found = mg.import_case(files, tmp_path / "case", reference=f"{REFERENCE} Hz", drive=["-", "20 mV"])
    table = found.case.records[1]
    assert (table.kind, table.lock_in_cycles, table.axis) == ("rate_table", 80, 0)
    np.testing.assert_allclose(table.phasors, phasors, rtol=1e-9)
    np.testing.assert_allclose(table.rate, np.radians(rate), rtol=1e-12)
    assert table.drive_force / found.case.records[0].drive[0] == pytest.approx(2.0)
    assert "each row is the mean over the 80 cycles of the drive" in str(found)


@pytest.mark.slow
def test_rows_at_a_rate_of_their_own_are_those_of_a_low_pass(tmp_path):
    """The prediction at a steady rate is that of linear algebra, whatever the time from row to row."""
    time, rate = np.arange(120) * 80.4 / REFERENCE, np.full(120, 300.0)
    stiffness, damping, omega = (
        (2 * np.pi * np.array([8050.0, 8700.0])) ** 2,
        np.array([20.0, 30.0]),
        2 * np.pi * REFERENCE,
    )
    gyration = 2j * omega * np.radians(300.0) * np.array([[0.0, 1.0], [-1.0, 0.0]])
    held = np.diag(stiffness - omega**2 + 1j * omega * damping) - gyration
    phasors = np.tile(1e5 * np.linalg.inv(held)[:, 0], (120, 1))
    rate[0] = 299.0  # a column that never moves is that of a table that stands still
    path = wrote(tmp_path / "table_drive_x.csv", time, phasors, rate)
    with pytest.raises(InputError, match=r'give it as in --reference "32.768 kHz"'):
        mg.import_case([path], tmp_path / "case", drive=["20 mV"])
    files = [swept(tmp_path / "drive_x_10mV.csv"), path]
    found = mg.import_case(files, tmp_path / "case", reference="8050 Hz", drive=["-", "20 mV"])
    table = found.case.records[1]
    assert table.lock_in_cycles is None
    assert table.block == pytest.approx(80.4 / REFERENCE)
    assert "the lock-in's low pass" in str(found)
    (experiment,) = [r.experiment for r in readings_of(found.case) if r.experiment.name == "rate tables"]
    device = NormalisedDevice([*stiffness, 0.0], [*damping, 0.0], 1e5 / table.drive_force)
    seen = np.asarray(experiment.predict(model_of(found.case, device, offset=np.zeros(2))))
    np.testing.assert_allclose(seen[20:], phasors[20:], rtol=1e-3)
    assert load_case(write_case(found.case, tmp_path / "again")).records[1].lock_in_cycles is None


@pytest.mark.parametrize(
    ("names", "columns"), [(("Vx [V]", "Vy [V]"), ""), (("CH1 [V]", "CH2 [V]"), "t=Time (s),x=CH1,y=CH2")]
)
def test_two_waveforms_that_die_out_are_a_free_decay_of_two_axes(names, columns, tmp_path):
    time = np.arange(4000) * 2e-5
    waves = np.exp(-40.0 * time)[:, None] * np.cos(2 * np.pi * REFERENCE * time[:, None] + np.array([0.0, 1.0]))
    waves = waves * np.array([0.2, 0.01]) + 1e-5 * np.random.default_rng(3).normal(size=(4000, 2))
    path, case = tmp_path / "scope.csv", tmp_path / "case"
    rows = (f"{t:.9g},{x:.12g},{y:.12g}" for t, (x, y) in zip(time, waves, strict=True))
    path.write_text("\n".join([",".join(["Time (s)", *names]), *rows]) + "\n")
    if columns:
        with pytest.raises(InputError, match=r"`CH1 \[V\]`, `CH2 \[V\]`.*`y=` for that of a second axis"):
            mg.import_case([path], case)
        with pytest.raises(InputError, match=r"one frequency, that of x, .*: frequency_x is 8050 Hz and qua"):
            mg.import_case([path], case, columns=columns)
        again = tmp_path / "again.csv"
        again.write_text("\n".join(path.read_text().splitlines()[:3000]))
        with pytest.raises(InputError, match=r"in `scope`, `again` channel x is the louder one.*exchanged\?"):
            mg.import_case([path, again], tmp_path / "two", columns=columns)
        return
    sweep, decay = mg.import_case([swept(tmp_path / "drive_x_10mV.csv"), path], case).case.records
    assert (sweep.kind, decay.kind) == ("frequency_sweep", "free_decay")
    np.testing.assert_allclose(decay.signals, waves, rtol=1e-9)


def test_the_drive_beside_a_rate_is_its_level(tmp_path):
    time, rate = np.arange(120) * 80 / REFERENCE, np.repeat([0.0, 50.0], 60)
    phasors, level = np.full((120, 2), 0.05 + 0.01j), np.full(120, 20.0)
    files = [swept(tmp_path / "drive_x_10mV.csv"), wrote(tmp_path / "table_drive_x.csv", time, phasors, rate, level)]
    found = mg.import_case(files, tmp_path / "case", reference="8050 Hz")
    assert found.case.records[1].drive_force / found.case.records[0].drive[0] == pytest.approx(2.0)
    assert "as the file does not say" not in str(found)
    level[70:] = 30.0
    files[1] = wrote(tmp_path / "table_drive_x.csv", time, phasors, rate, level)
    with pytest.raises(InputError, match="the drive of a rate table must stay as it is, but `Drive` moves"):
        mg.import_case(files, tmp_path / "other", reference="8050 Hz")


def test_a_decay_on_a_table_that_stands_still_is_a_decay(tmp_path):
    time = np.arange(200) * 5e-4
    files = [swept(tmp_path / "drive_x_10mV.csv"), wrote(tmp_path / "ring.csv", time, decayed(time), 0.0 * time)]
    assert mg.import_case(files, tmp_path / "case", reference="8050 Hz").case.records[1].kind == "free_decay"


@pytest.mark.parametrize(("sign", "beat"), [(-1, 30.0), (1, 30.0), (-1, -30.0)])
def test_a_decay_turns_as_its_resonance_says(sign, beat, tmp_path):
    """Of a lock-in 30 Hz beside the resonance of sweeps that follow e^{-iωt}, or not."""
    time = np.arange(200) * 5e-4
    turning = np.exp((2j * np.pi * beat - 60.0) * time)[:, None] * np.array([0.05 + 0.02j, 0.004j])
    files = [swept(tmp_path / "drive_x_10mV.csv", sign), wrote(tmp_path / "ring.csv", time, turning)]
    decay = mg.import_case(files, tmp_path / "case", reference="8020 Hz").case.records[1]
    right = turning if beat > 0 else turning.conj()  # the resonance is at 8050 Hz
    np.testing.assert_allclose(decay.signals, right, rtol=1e-9)


TWO_DRIVES = "t [s],{0}_x [{1}],{0}_y [{1}],Vx [V],Vy [V],rate [deg/s]"


def driven(path, header, keep=6):
    """Both axes driven by noise, as a closed loop drives them; as many columns as wanted."""
    draw = np.random.default_rng(5)
    push = draw.normal(size=(2000, 2))
    pole = 0.99 * np.exp(1j * np.array([0.5, 0.6]))  # of each axis
    answer = [lfilter([0.0, 0.1], np.poly([p, p.conj()]).real, column) for p, column in zip(pole, push.T, strict=True)]
    wave = np.stack(answer, axis=1) + 1e-4 * draw.normal(size=(2000, 2))
    columns = np.column_stack([np.arange(2000) * 2e-5, push, wave, np.full(2000, 10.0)])[:, :keep]
    lines = (",".join(f"{value:.9g}" for value in row) for row in columns)
    path.write_text("\n".join([",".join(header.split(",")[:keep]), *lines]) + "\n")
    return path, columns


@pytest.mark.parametrize(("letter", "unit"), [("u", "V"), ("F", "uN")])
@pytest.mark.parametrize("said", [False, True])
def test_two_drives_and_two_waveforms_are_a_time_record(letter, unit, said, tmp_path):
    header = TWO_DRIVES.format(letter, unit)
    path, columns = driven(tmp_path / "loop.csv", header)
    words = ("t", f"{letter}_x", f"{letter}_y", "x", "y", "rate")
    options = (
        ",".join(f"{word}={column}" for word, column in zip(words, header.split(","), strict=True)) if said else ""
    )
    found = mg.import_case([path], tmp_path / "case", columns=options)
    (record,) = found.case.records
    scale = 1e-6 if unit == "uN" else 1.0
    assert (found.case.device, record.kind) == ("single_mass", "time_record")
    np.testing.assert_allclose(record.forces, scale * columns[:, 1:3], rtol=1e-8)
    np.testing.assert_allclose(record.signals, columns[:, 3:5], rtol=1e-8)
    np.testing.assert_allclose(record.rate, np.radians(10.0))
    assert "Not used" not in str(found)


def test_the_second_of_two_mapped_drives_may_be_silent(tmp_path):
    path, _ = driven(tmp_path / "loop.csv", TWO_DRIVES.format("u", "V"))
    ((table,),) = [read_instrument_file(path)[1]]
    meaning = meaning_of(table, parse_map("t=t,u_x=0*u_x,u_y=u_y,x=Vx,y=Vy"))
    assert (meaning.columns["drive"].name, meaning.driven) == ("u_y", "y")
    assert "y_drive" not in meaning.columns


def test_drives_that_no_name_tells_apart_are_in_the_map_to_copy(tmp_path):
    header = "t [s],drive A [V],drive B [V],Vx [V],Vy [V]"
    path, columns = driven(tmp_path / "loop.csv", header, keep=5)
    with pytest.raises(InputError, match="more than one column may be the drive") as told:
        mg.import_case([path], tmp_path / "case")
    copied = str(told.value).split('--map "')[1].split('"')[0]
    assert copied == "t=t [s],x=Vx [V],y=Vy [V],u_x=drive A [V],u_y=drive B [V]"
    (record,) = mg.import_case([path], tmp_path / "case", columns=copied).case.records
    np.testing.assert_allclose(record.forces, columns[:, 1:3], rtol=1e-8)


def test_the_driven_axis_of_two_waveforms_is_asked_for(tmp_path):
    path, _ = driven(tmp_path / "loop.csv", "t [s],drive [V],sigma [V],Vx [V],Vy [V]", keep=5)
    with pytest.raises(InputError, match=r"driven axis must be known.*--axis [xy] "):
        mg.import_case([path], tmp_path / "case")


def test_a_decay_alone_whose_calibration_is_declared_is_led_to_a_case(tmp_path):
    """The comment that `import` writes, step by step: a gain in volts had stood in the way, and a mass was refused."""
    time = np.arange(4000) * 2e-5
    wave = 0.2 * np.exp(-40.0 * time) * np.cos(2 * np.pi * 8050.0 * time)
    wave += 1e-5 * np.random.default_rng(3).normal(size=4000)
    path, file = tmp_path / "ring.csv", tmp_path / "case" / "case.toml"
    path.write_text("\n".join(["Time (s),Vx [V]", *(f"{t:.9g},{v:.12g}" for t, v in zip(time, wave, strict=True))]))
    case = mg.import_case([path], tmp_path / "case").case
    assert case.design["quality_factor"].value == pytest.approx(np.pi * 8050.0 / 40.0, rel=0.01)
    text = file.read_text()
    (mass,) = re.findall(r"mass = \{.*?\}", text)
    massive = text.replace("[design]\n", f"[design]\n{mass}\n", 1)
    file.write_text(massive)
    with pytest.raises(
        InputError, match=r"`scale` under `\[readout\]`, and its drive a force, by `\[drive\]` with `unit"
    ):
        load_case(tmp_path / "case")
    (scale,) = re.findall(r"scale = \{.*?\}", text)
    file.write_text(massive.replace("[readout]\n", f'[drive]\nunit = "N"\n[readout]\n{scale}\n', 1))
    assert load_case(tmp_path / "case").design["static_gain"].value == pytest.approx(
        1.0 / (1e-9 * (2 * np.pi * 8050.0) ** 2), rel=1e-3
    )
    gain = 'static_gain = { value = 1.0, tolerance = 0.5, unit = "mV/V" }'
    file.write_text(
        text.replace("[design]\n", f"[design]\n{gain}\n", 1).replace("[readout]\n", f"[readout]\n{scale}\n", 1)
    )
    with pytest.raises(InputError, match=r"displacements are lengths; a gain that nothing needs is left out"):
        load_case(tmp_path / "case")


def test_a_damping_that_a_decay_does_not_tell_is_left_to_the_fit():
    """A pendulum that does not fall: `import` wrote a quality factor of 5e8 within a factor of three, which
    `check` then laid beside what the records show.
    """
    time = 0.0257 * np.arange(600)
    rough = rough_decay(time, np.exp(0.05 * time) * np.cos(2 * np.pi * 1.08 * time))
    text = _design([SimpleNamespace(design=rough, two_axes=False)], two=False)
    assert rough["resonance"][0] == pytest.approx(1.08, rel=0.02)
    assert "resonance = { value = 1.0" in text
    assert "quality_factor = { unknown = true }" in text


@pytest.mark.parametrize(("hertz", "told"), [(1.08, True), (6.2, False)])
def test_a_decay_of_fewer_than_four_periods_is_told(hertz, told, tmp_path):
    """Of a pendulum's two swings the third harmonic was taken for the resonance, without a word."""
    time = 0.0257 * np.arange(90)
    turn = 2 * np.pi * hertz * time
    volts = 40.0 * np.exp(-0.35 * time) * (np.cos(turn) + 0.3 * np.cos(3 * turn) * (hertz < 2))
    volts += 0.2 * np.random.default_rng(3).normal(size=time.size)
    np.savetxt(tmp_path / "a.csv", np.column_stack([time, volts]), delimiter=",", header="t [s],x [V]", comments="")
    text = str(mg.import_case([tmp_path / "a.csv"], tmp_path / "case"))
    assert ("most of what vibrates is below" in text) == told, text


def test_an_envelope_in_decibels_is_no_waveform(tmp_path):
    """Of a spectrum analyser in zero span: the map to copy took it for a waveform of 3 Hz, as "no column is a time"."""
    time = 0.012 * np.arange(300)
    rows = [f"{t:.3f}, {-46.0 - 1.5 * t + 0.2 * np.sin(40.0 * t):.6f}" for t in time]
    (tmp_path / "ring.txt").write_text("\n".join(["% time [s], power [dBm]", *rows]) + "\n")
    for given in ("", "t=time [s],x=power [dBm]", "t=time [s],x_amp=power [dBm]"):
        with pytest.raises(InputError, match=r"`power \[dBm\]` is an amplitude in decibels") as refused:
            mg.import_case([tmp_path / "ring.txt"], tmp_path / "case", columns=given)
        assert "no column is a time" not in str(refused.value)
        assert "--map" not in str(refused.value)
