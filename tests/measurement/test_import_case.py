"""Files of instruments become a case that loads, checks and says what was assumed."""

import json

import instrument_files as w
import nptdms
import numpy as np
import pytest

import memsgyro_jax as mg
from memsgyro_jax.app import cli
from memsgyro_jax.measurement.begin_of_decay import begin_of_decay
from memsgyro_jax.measurement.column_meaning import meaning_of
from memsgyro_jax.measurement.formats import read_instrument_file
from memsgyro_jax.measurement.imported_record import Given, records_of


def ring_down(path, frequency=3200.0, quality=2000.0, rows=4000, rate=20e3):
    """A decay of a waveform in volts behind a moment of steady vibration, in TDMS."""
    time = np.arange(rows) / rate
    begin = 0.02
    decay = np.exp(-np.pi * frequency / quality * np.clip(time - begin, 0.0, None))
    noise = np.random.default_rng(3).normal(0.0, 1e-3, rows)
    values = decay * np.cos(2 * np.pi * frequency * time + 0.4) + noise
    about = {"wf_increment": 1 / rate, "wf_start_offset": 0.0, "unit_string": "V"}
    with nptdms.TdmsWriter(str(path)) as writer:
        writer.write_segment([nptdms.ChannelObject("scope", "ai0", values, about)])
    return path


@pytest.fixture
def sweeps(tmp_path):
    """Three sweeps of a lock-in, up and down, whose names tell the drive."""
    paths = []
    for level in (10, 20, 40):
        path = tmp_path / f"sweep_{level}mV.csv"
        w.labone_sweeps(path, level / 10, noise=1e-7)
        paths.append(path)
    return paths


def test_several_files_become_records_of_one_case(sweeps, tmp_path):
    found = mg.import_case(sweeps, tmp_path / "case")
    case = found.case
    assert [record.name for record in case.records] == [
        f"sweep_{level}mV_chunk_{n}" for level in (10, 20, 40) for n in (0, 1)
    ]
    np.testing.assert_allclose(case.records[2].drive, 20e-3)
    np.testing.assert_allclose(case.records[2].phasors[:, 0], 2 * w.RESPONSE, atol=6e-7)
    assert case.design["resonance"].value == pytest.approx(2 * np.pi * 4000.0, rel=1e-4)
    assert case.design["quality_factor"].value == pytest.approx(80.0, rel=0.02)
    assert "effective values" in str(found)
    text = (tmp_path / "case" / "case.toml").read_text()
    assert "# assumed: the drive is 10 mV, as the file's name says" in text
    assert found.to_dict()["records"][5]["rows"] == len(w.FREQUENCY)
    assert len(mg.assess(case).records) == 6


def test_a_decay_begins_where_its_envelope_falls(tmp_path):
    case = mg.import_case([ring_down(tmp_path / "decay.tdms")], tmp_path / "case").case
    (record,) = case.records
    assert record.kind == "free_decay"
    assert 0.02 <= record.time[0] < 0.05
    assert case.design["resonance"].value == pytest.approx(2 * np.pi * 3200.0, rel=1e-3)
    assert case.design["quality_factor"].value == pytest.approx(2000.0, rel=0.2)


@pytest.mark.parametrize(
    ("quality", "noise"), [(1e5, 1e-3), pytest.param(3e4, 0.03, marks=pytest.mark.slow), (3e3, 0.003)]
)
def test_a_decay_that_hardly_falls_begins_at_its_first_row(tmp_path, quality, noise):
    time = np.arange(30000) / 100e3
    signal = np.exp(-np.pi * 14e3 / quality * time) * np.cos(2 * np.pi * 14e3 * time)
    signal = signal + noise * np.random.default_rng(1).standard_normal(time.size)
    rows = [f"{t:.6f},{v:.7g}" for t, v in zip(time, signal, strict=True)]
    (tmp_path / "slow.csv").write_text("\n".join(["t [s],y [V]", *rows]))
    (record,) = mg.import_case([tmp_path / "slow.csv"], tmp_path / "case").case.records
    assert (record.kind, record.rows) == ("free_decay", 30000)


def test_a_decay_that_is_clipped_first_begins_behind(tmp_path):
    """On an oscilloscope whose range is 0.4 of the swing: what was clipped told a quality factor of 340, of 240."""
    time = np.arange(12000) / 10e3
    signal = 2.4 * np.exp(-np.pi * 523 / 240 * time) * np.cos(2 * np.pi * 523 * time)
    steps = np.clip(np.round(signal * 128.0) / 128.0, -1.0, 127.0 / 128.0)
    (tmp_path / "scope.csv").write_text(
        "\n".join(["t [s],y [V]", *(f"{t:.5f},{v:.6f}" for t, v in zip(time, steps, strict=True))])
    )
    _, (table,) = read_instrument_file(tmp_path / "scope.csv")
    (record,) = records_of("scope", table, meaning_of(table, {}), Given())
    assert "where it is no longer clipped" in str(record.assumed)
    assert "where it falls below four steps of 0.00781 V" in str(record.assumed)
    assert record.keys["to"]["value"] == pytest.approx(240 / np.pi / 523 * np.log(2.4 * 128 / 4), abs=0.02)
    assert record.keys["from"]["value"] == pytest.approx(240 / np.pi / 523 * np.log(2.4), abs=2e-3)
    assert record.design["quality_factor"][0] == pytest.approx(240.0, rel=0.02)


@pytest.mark.parametrize(("kept_up", "first"), [(0.0, 0), (0.03, 150)])
def test_a_decay_that_halves_in_an_eighth_of_its_record_begins_at_its_first_row(kept_up, first):
    """It lost 2.4 % of its rows and 13 % of its amplitude; what is kept up first is still left out."""
    time = np.arange(4000) / 4000
    signal = np.exp(-np.log(2.0) * np.maximum(time - kept_up, 0.0) / 0.12) * np.cos(2 * np.pi * 400 * time + 1.0)
    signal = signal + 1e-3 * np.random.default_rng(0).standard_normal(time.size)
    assert begin_of_decay(signal) == pytest.approx(first, abs=60 if kept_up else 0)


def test_what_is_forced_and_what_is_free_of_one_run_are_two_records(tmp_path):
    time = np.arange(4000) / 20e3
    drive = np.where(time < 0.1, np.cos(2 * np.pi * 3200 * time), 0.0)
    signal = np.cos(2 * np.pi * 3200 * time) * np.minimum(time / 0.05, np.exp(-np.clip(time - 0.1, 0, None) / 0.03))
    rows = [f"{t:.6f};{u:.6g};{y:.6g}" for t, u, y in zip(time, drive, signal, strict=True)]
    (tmp_path / "run.csv").write_text("\n".join(["time/s;excitation/mV;velocity in volts [V]", *rows]))
    found = mg.import_case([tmp_path / "run.csv"], tmp_path / "case")
    forced, free = found.case.records
    assert (forced.kind, forced.start, forced.rows) == ("time_record", "rest", 2000)
    assert free.kind == "free_decay"
    assert free.time[0] >= 0.1
    moving = np.cos(2 * np.pi * 3200 * time) * np.exp(-np.clip(time - 0.1, 0, None) / 0.03)
    rows = [f"{t:.6f};{u:.6g};{y:.6g}" for t, u, y in zip(time, drive, moving, strict=True)]
    (tmp_path / "run.csv").write_text("\n".join(["time/s;excitation/mV;velocity in volts [V]", *rows]))
    again = mg.import_case([tmp_path / "run.csv"], tmp_path / "moving")
    assert [record.kind for record in again.case.records] == ["free_decay"]
    assert "its unknown start does not die out" in str(again)


@pytest.mark.parametrize(("unit", "order"), [("g_0", 2), ("mm/s", 1), ("um", 0)])
def test_the_unit_of_a_decay_says_what_is_read(unit, order, tmp_path):
    time = np.arange(400) / 4e3
    rows = [f"{t:.6f},{v:.6f}" for t, v in zip(time, np.exp(-30 * time) * np.cos(400 * np.pi * time), strict=True)]
    (tmp_path / "a.csv").write_text("\n".join([f"t [s],a [{unit}]", *rows]))
    case = mg.import_case([tmp_path / "a.csv"], tmp_path / "case").case
    assert case.readout.order == order
    assert case.records[0].kind == "free_decay"


def test_what_is_no_vibration_is_refused_in_one_sentence(tmp_path):
    rows = {
        "levels.csv": [f"{n * 1e-3},{n // 40 % 2}" for n in range(90)],
        "ramp.csv": [f"{n * 1e-3},{n * (-1) ** n}" for n in range(90)],
        "still.csv": [f"{n * 1e-3},0" for n in range(90)],
        "flat.csv": [f"{1000 + n},{x},{y}" for n, (x, y) in enumerate(np.random.default_rng(0).normal(size=(90, 2)))],
    }
    for name, lines in rows.items():
        header = "f [Hz],X [V],Y [V]" if name == "flat.csv" else "time [s],line 0 [V]"
        (tmp_path / name).write_text("\n".join([header, *lines]))
        words = "no record that may be fitted shows a clear resonance" if name == "flat.csv" else "that dies away"
        with pytest.raises(mg.InputError, match=words):
            mg.import_case([tmp_path / name], tmp_path / "case")


def test_phasors_over_time_need_their_reference(tmp_path):
    time = np.arange(400) / 1e3
    z = np.exp((-5 + 2j * np.pi * 0.7) * time)
    rows = [f"{t},{p.real},{p.imag}" for t, p in zip(time, z, strict=True)]
    (tmp_path / "a.csv").write_text("\n".join(["t [s],X [mV],Y [mV]", *rows]))
    with pytest.raises(mg.InputError, match="--reference"):
        mg.import_case([tmp_path / "a.csv"], tmp_path / "case")
    case = mg.import_case([tmp_path / "a.csv"], tmp_path / "case", reference="4 kHz").case
    assert case.records[0].reference_frequency == pytest.approx(2 * np.pi * 4000.0)
    assert not case.records[0].uneven
    (tmp_path / "a.csv").write_text("\n".join(["t [s],X [mV],Y [mV]", *rows[:90], *rows[100:]]))
    lost = mg.import_case([tmp_path / "a.csv"], tmp_path / "lost", reference="4 kHz")
    assert lost.case.records[0].uneven
    assert lost.case.design["resonance"].value == pytest.approx(2 * np.pi * 4000.7, rel=1e-4)
    assert "Assumed of the rows: the time of each row is right (`uneven`), though rows are lost." in str(lost)
    assert case.design["resonance"].value == pytest.approx(2 * np.pi * 4000.7, rel=1e-4)
    peak = "`X` tells peak amplitudes (`--rms` where they are effective values)"
    assert peak in str(lost)
    effective = mg.import_case([tmp_path / "a.csv"], tmp_path / "rms", reference="4 kHz", rms=True)
    assert peak not in str(effective)
    assert effective.case.records[0].signals == pytest.approx(np.sqrt(2.0) * lost.case.records[0].signals)


def test_a_long_record_is_thinned(tmp_path):
    """Behind a low pass the noise falls with the rows, and the vibration stays as it is."""
    path = ring_down(tmp_path / "decay.tdms", frequency=320.0, quality=100.0, rows=12_000)
    whole, tenth = (mg.import_case([path], tmp_path / f"by_{n}", every=n) for n in (1, 10))
    assert "one row of 10 is kept, behind a low pass" in str(tenth)
    (long,), (short,) = whole.case.records, tenth.case.records
    assert short.period == pytest.approx(10.0 * long.period)
    assert len(short.time) == pytest.approx(len(long.time) / 10.0, abs=60)
    assert tenth.case.design["resonance"].value == pytest.approx(2 * np.pi * 320.0, rel=1e-3)
    rows = slice(20, -20)  # but where the record ends
    at = np.searchsorted(long.time, short.time[rows] - 0.5 * long.period)
    assert np.std(short.signals[rows] - long.signals[at]) < 1.5e-3
    with pytest.raises(mg.InputError, match=r"keeps fewer than 5 rows in a period \(at most --every 12 leaves 5\)"):
        mg.import_case([path], tmp_path / "no", every=20)
    rows = ["t [s],f [Hz],X [V],Y [V]", *(f"{n},{1000 + n},{n % 7},1" for n in range(40))]
    (tmp_path / "a.csv").write_text("\n".join(rows))
    with pytest.raises(mg.InputError, match="must not thin a sweep with a clock"):
        mg.import_case([tmp_path / "a.csv"], tmp_path / "no", every=2)


def test_a_folder_that_is_there_is_kept_unless_told(sweeps, tmp_path):
    mg.import_case(sweeps[:1], tmp_path / "case")
    before = sorted((tmp_path / "case").iterdir())
    with pytest.raises(mg.InputError, match="--overwrite"):
        mg.import_case(sweeps[1:2], tmp_path / "case")
    assert sorted((tmp_path / "case").iterdir()) == before
    again = mg.import_case(sweeps[1:2], tmp_path / "case", overwrite=True)
    assert [record.file for record in again.case.records] == ["sweep_20mV_chunk_0.csv", "sweep_20mV_chunk_1.csv"]


def test_nothing_is_left_of_an_import_that_fails(sweeps, tmp_path):
    sweeps[1].write_text("no numbers\n")
    before = set(tmp_path.iterdir())
    with pytest.raises(mg.InputError, match=r"sweep_20mV\.csv"):
        mg.import_case(sweeps, tmp_path / "case")
    assert set(tmp_path.iterdir()) == before


def test_one_reading_over_frequency_is_an_amplitude_in_its_own_unit(tmp_path):
    """A vibrometer's velocity with a phase beside it: displacements are then in metres, and so are strengths."""
    answer = w.RESPONSE * 2j * np.pi * w.FREQUENCY
    rows = [f"{f:.3f},{abs(v):.6g},{np.degrees(np.angle(v)):.3f}" for f, v in zip(w.FREQUENCY, answer, strict=True)]
    (tmp_path / "v_2V.csv").write_text("\n".join(["frequency_Hz,velocity_mm_s,phase_deg", *rows]))
    found = mg.import_case([tmp_path / "v_2V.csv"], tmp_path / "case")
    (record,) = found.case.records
    np.testing.assert_allclose(record.phasors[:, 0], 1e-3 * answer, rtol=1e-4)
    assert (found.case.readout.order, found.case.words.displacement) == (1, "m")
    assert "amplitudes are peak values" in str(found)
    assert "Calibration" not in str(found)


def test_the_command_prints_what_it_assumed_and_what_to_do_next(sweeps, tmp_path, capsys):
    with pytest.raises(SystemExit) as ended:
        cli.main(
            ["import", *map(str, sweeps), "--out", str(tmp_path / "case"), "--json", str(tmp_path / "a.json"),
             "--drive", "1 mV", "2 mV", "4 mV"]
        )  # fmt: skip
    assert ended.value.code == 0
    out = capsys.readouterr().out
    assert "Assumed of the readings: " in out
    assert "memsgyro check" in out
    entries = json.loads((tmp_path / "a.json").read_text())
    assert entries["schema"] == "memsgyro-import/1"
    assert all("drive" not in sentence for record in entries["records"] for sentence in record["assumed"])


@pytest.mark.parametrize(
    ("options", "what"),
    [
        (["--drive", "1 mV", "2 mV"], "--drive"),
        (["--drive", "much"], "--drive"),
        (["--drive", "10 mv"], "Unit of option `--drive` must be one that can be read"),
        (["--drive", "10 mv"], 'but is "mv"; did you mean "mV"?'),
        (["--drive", "-10 dB"], '"-10 dB"'),
        (["--reference", "3 khz"], 'did you mean "kHz"?'),
        (["--map", "f=nothing"], "--map"),
        (["--reference", "-3 Hz"], "--reference"),
    ],
)
def test_wrong_options_are_one_sentence(options, what, sweeps, tmp_path, capsys):
    with pytest.raises(SystemExit) as ended:
        cli.main(["import", *map(str, sweeps), "--out", str(tmp_path / "case"), *options])
    assert ended.value.code == 2
    assert what in capsys.readouterr().err


def test_a_level_may_be_an_effective_value(sweeps, tmp_path):
    for level, peak in (("10 mVrms", 10e-3 * np.sqrt(2.0)), ("10 mVpp", 5e-3), ("10 mVpk", 10e-3)):
        case = mg.import_case(sweeps[:1], tmp_path / level, drive=(level,)).case
        np.testing.assert_allclose(case.records[0].drive, peak)


def falling(path):
    """A waveform of a scope that falls from its first row."""
    time = np.arange(4000) / 20e3
    values = np.exp(-20.0 * time) * np.cos(2 * np.pi * 3200.0 * time)
    path.write_text(
        "Time;Channel A\n(s);(V)\n\n" + "\n".join(f"{t:.6f};{v:.6f}" for t, v in zip(time, values, strict=True))
    )
    return path


def test_levels_are_for_the_files_that_need_one(sweeps, tmp_path, capsys):
    """Three levels for three sweeps and a decay, which keeps all of its rows: they tell most where it is strongest."""
    plain = [path.rename(tmp_path / f"file{k}.csv") for k, path in enumerate(sweeps)]
    files = [*plain, falling(tmp_path / "scope.txt")]
    found = mg.import_case(files, tmp_path / "case", drive=("1 mV", "2 mV", "3 mV"))
    *swept, decay = found.case.records
    np.testing.assert_allclose([record.drive[0] for record in swept], np.repeat([1e-3, 2e-3, 3e-3], 2))
    assert decay.time[0] == 0.0
    assert len(decay.time) == 4000
    assert "(all sweeps)" in str(found)
    assert "2 mV   -      1 sweeps of x" in str(found)
    assert not found.warning
    words = ["import", *map(str, files), "--drive", "1 mV", "2 mV", "3 mV", "-", "--out", str(tmp_path / "dashed")]
    with pytest.raises(SystemExit) as ended:
        cli.main(words)
    assert ended.value.code == 0
    assert "Not used: the drive" not in capsys.readouterr().out
    more = mg.import_case(files, tmp_path / "more", drive=("1 mV", "2 mV", "3 mV", "4 mV"))
    assert "Not used: the drive of 4 mV, as scope.txt does not need it." in str(more)
    with pytest.raises(mg.InputError, match="`-` for one that needs no level"):
        mg.import_case(files, tmp_path / "two", drive=("1 mV", "2 mV"))
    silent = str(mg.import_case(files, tmp_path / "silent"))
    assert "WARNING: 3 files do not say at which level" in silent
    assert silent.endswith(f'--out {tmp_path / "silent"} --overwrite --drive "..." "..." "..." -')
    assert "WARNING" not in str(mg.import_case([*files[:1], files[3]], tmp_path / "one"))


def test_records_agree_on_what_is_read(tmp_path):
    """A resonance bent beyond the band shows its largest reading at the band's end, where no phase tells."""
    offset = np.linspace(-40.0, 60.0, 101)

    def wrote(name, turn, bend=0.0):
        phasors = turn / (offset - bend - 4j)
        rows = [f"{3e3 + df},{v.real!r},{v.imag!r}" for df, v in zip(offset.tolist(), phasors.tolist(), strict=True)]
        (tmp_path / name).write_text("\n".join(["frequency (Hz),x (V),y (V)", *rows]))
        return tmp_path / name

    bent, *others = wrote("a_20mV.csv", -1.0, 80.0), wrote("b_2mV.csv", -1.0), wrote("c_3mV.csv", -1.0)
    made = mg.import_case([bent, *others], tmp_path / "case")
    assert "largest reading ends the band" in " ".join(made.records[0].assumed)
    assert 'quantity = "displacement"' in (tmp_path / "case" / "case.toml").read_text()
    odd = wrote("0_1mV.csv", 1j)
    assert "shows velocity" in " ".join(mg.import_case([odd], tmp_path / "odd").records[0].assumed)
    both = mg.import_case([odd, *others], tmp_path / "both")
    assert both.records[0].assumed[-1].startswith("most records show displacement")
    assert 'quantity = "displacement"' in (tmp_path / "both" / "case.toml").read_text()


def test_gains_in_decibels_are_ratios_to_the_drive(tmp_path):
    """The gain of a linear device is the same at every level; taken for readings it denied all but one."""
    f = np.linspace(9900.0, 10100.0, 41)
    gain = 1e5 / (10000.0**2 - f**2 + 2j * f * 10.0)
    files = []
    for level in (10, 40):
        lines = [
            f"{a},{20 * np.log10(abs(z)):.15g},{np.degrees(np.angle(z)):.15g}" for a, z in zip(f, gain, strict=True)
        ]
        files.append(tmp_path / f"gain_{level}mV.csv")
        files[-1].write_text("\n".join(["Frequency (Hz),Gain (dB),Phase (deg)", *lines]) + "\n")
    found = mg.import_case(files, tmp_path / "case")
    for record, level in zip(found.case.records, (0.010, 0.040), strict=True):
        np.testing.assert_allclose(record.phasors[:, 0], level * gain, rtol=1e-9)
        np.testing.assert_allclose(record.drive, level)
    assert "the readings in dB are ratios to the drive" in str(found)


def test_a_copy_of_a_file_is_not_used(tmp_path):
    """Counted twice, noise that repeats to the last digit looks like an effect."""
    f, noise = np.linspace(9900.0, 10100.0, 41), 1e-5 * np.random.default_rng(0).normal(size=(2, 41))
    z = 1e5 / (10000.0**2 - f**2 + 2j * f * 10.0) + noise[0] + 1j * noise[1]
    lines = "\n".join(f"{a},{b.real:.9e},{b.imag:.9e}" for a, b in zip(f, z, strict=True))
    files = [tmp_path / "first.csv", tmp_path / "copy.csv"]
    for file, header in zip(files, ("f [Hz],X [V],Y [V]", "Frequency (Hz),X (V),Y (V)"), strict=True):
        file.write_text(f"{header}\n{lines}\n")
    lone = mg.import_case(files, tmp_path / "lone")
    assert "Not used: copy.csv, as its rows are those of first.csv." in str(lone)
    assert not lone.warning, "one file is left, whose level scales all"
    said = tmp_path / "first_10mV.csv"
    said.write_text(files[0].read_text())
    found = mg.import_case([files[1], said], tmp_path / "case")
    assert [record.name for record in found.case.records] == ["first_10mV"], "the one whose level is told"
    levels = mg.import_case(files, tmp_path / "both", drive=["10 mV", "20 mV"])
    assert len(levels.case.records) == 2


@pytest.mark.parametrize("by_command", [True, False])
def test_each_file_may_have_a_map_of_its_own(by_command, tmp_path):
    """Files of two instruments, whose columns are named otherwise; the names of one tell."""
    table = np.stack([w.FREQUENCY, w.RESPONSE.real, w.RESPONSE.imag], axis=1)
    for level, header in ((10, "Frequency [Hz],X [V],Y [V]"), (20, "axis,re,im"), (30, "c1,c2,c3")):
        rows = [",".join(f"{v:.9g}" for v in (row[0], level * row[1], level * row[2])) for row in table]
        (tmp_path / f"sweep_{level}mV.csv").write_text("\n".join([header, *rows]) + "\n")
    files = [tmp_path / f"sweep_{level}mV.csv" for level in (10, 20, 30)]
    maps = ["-", "f=axis [Hz],x_I=re [V],x_Q=im [V]", "f=c1 [Hz],x_I=c2 [V],x_Q=c3 [V]"]
    if by_command:
        folder = tmp_path / "case"
        with pytest.raises(SystemExit, match=r"^0$"):
            cli.main(["import", *map(str, files), "--out", str(folder), "--map", *maps])
        case = mg.load_case(folder)
    else:
        case = mg.import_case(files, tmp_path / "case", columns=maps).case
    for record, level in zip(case.records, (10, 20, 30), strict=True):
        np.testing.assert_allclose(record.phasors[:, 0], level * w.RESPONSE, rtol=1e-7)
    with pytest.raises(mg.InputError, match="given once or for each of 3 files"):
        mg.import_case(files, tmp_path / "other", columns=maps[:2])


def test_what_each_file_was_recorded_at_may_be_given(sweeps, tmp_path):
    given = {"bias": ["10 V", "-", "0.02 kV"], "temperature": ["-40 degC"]}
    found = mg.import_case(sweeps, tmp_path / "case", **given)
    volts = [float(np.unique(record.bias_voltage)[0]) for record in found.case.records]
    assert volts == [10.0, 10.0, found.case.environment.bias_voltage, found.case.environment.bias_voltage, 20.0, 20.0]
    assert all(np.allclose(record.temperature, 233.15) for record in found.case.records)
    assert "the bias voltage is 10 V, as was given" in str(found)


@pytest.mark.parametrize(
    ("given", "sentence"),
    [
        ({"bias": ["10 V", "20 V"]}, "`--bias` must be given once or for each of 3 files"),
        ({"bias": ["10"]}, 'must be a number with its unit, like "20 V", but is "10"'),
        ({"temperature": ["10 V"]}, "option `--temperature`"),
    ],
)
def test_conditions_that_are_none_are_refused(given, sentence, sweeps, tmp_path):
    with pytest.raises(mg.InputError, match=sentence):
        mg.import_case(sweeps, tmp_path / "case", **given)


def test_a_bias_that_a_column_says_is_not_given_again(tmp_path):
    rows = "\n".join(f"{f},10.0,{z.real},{z.imag}" for f, z in zip(w.FREQUENCY, w.RESPONSE, strict=True))
    path = tmp_path / "sweep.csv"
    path.write_text(f"f [Hz],Bias [V],X [V],Y [V]\n{rows}\n")
    with pytest.raises(mg.InputError, match="`--bias` must be left out"):
        mg.import_case([path], tmp_path / "case", bias=["12 V"])
