"""What the rows tell of noise, outliers and settling."""

import re
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from lab import driven
from measurement.case.bench import NOISE, write_bench
from scipy import signal, stats

import memsgyro_jax
from memsgyro_jax.measurement.beside_design import _number, _scale_that_agrees, beside_design
from memsgyro_jax.measurement.case import assess, load_case
from memsgyro_jax.measurement.declared import Drive
from memsgyro_jax.measurement.import_case import import_case
from memsgyro_jax.measurement.least_squares import gate
from memsgyro_jax.measurement.noise import (
    freedom_over_frequency,
    freedom_over_time,
    jitter_noise,
    noise_beside_misfit,
    noise_over_frequency,
    noise_over_time,
)
from memsgyro_jax.measurement.outliers import interpolation_misfit, lone_rows


CASES = Path(__file__).resolve().parents[4] / "shared" / "data" / "cases"


@pytest.fixture(scope="module")
def bench(tmp_path_factory):
    return load_case(write_bench(tmp_path_factory.mktemp("quality") / "bench"))


def quality(case, name):
    return next(found for found in assess(case).records if found.record.name == name)


def with_record(case, name, **changes):
    return replace(case, records=tuple(replace(r, **changes) if r.name == name else r for r in case.records))


def test_a_cubic_is_interpolated_without_error():
    place = np.cumsum(np.random.default_rng(0).uniform(0.5, 1.5, 40))
    values = 1 + place - 0.3 * place**2 + 0.01 * place**3
    assert np.max(np.abs(interpolation_misfit(place, values))) < 1e-10


def test_the_misfit_of_white_noise_has_its_deviation():
    rng = np.random.default_rng(1)
    place = np.cumsum(rng.uniform(0.5, 1.5, 20000))
    assert np.std(interpolation_misfit(place, rng.normal(0, 3.0, 20000))) == pytest.approx(3.0, rel=0.03)


@pytest.mark.parametrize("name", ["sweep_x", "ringdown", "rate", "raw"])
def test_noise_is_told_by_the_rows(bench, name):
    assert quality(bench, name).noise == pytest.approx(NOISE, rel=0.15)


@pytest.fixture(scope="module")
def demo():
    return load_case(Path(memsgyro_jax.__file__).parent / "demo")


@pytest.mark.parametrize("name", ["sweep_x", "sweep_y", "ringdown_x", "rate", "raw", "raw_check"])
def test_noise_left_out_is_estimated(demo, name):
    """Of a ring-down of three samples per cycle, of resonances of a dozen rows: the laboratory's own to a tenth."""
    record = demo.record(name)
    assert replace(record, noise_std=None).noise_level == pytest.approx(record.noise_std, rel=0.1)


def test_the_demonstration_is_faultless(demo):
    """Rates that begin to turn, resonances of few rows and drives of just five time constants are no faults."""
    assert assess(demo).warnings == ()


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("quality", [30.0, 1000.0])
def test_a_resonance_is_not_taken_for_noise(quality, seed):
    """Two coupled modes, twelve rows over the narrower one; white noise of 1 beside a peak of 10 000."""
    rng, f = np.random.default_rng(seed), np.linspace(0.9, 1.1, 120)
    f = np.sort(np.concatenate([f, 1 + np.linspace(-1, 1, 12) / quality]))
    clean = 1e4 / quality / (1 - f**2 + 1j * f / quality) + 50 / (1.3 - f**2)
    noisy = (clean + rng.normal(size=f.size) + 1j * rng.normal(size=f.size))[:, None]
    assert noise_over_frequency(f, noisy, [slice(0, f.size)]) == pytest.approx(1.0, rel=0.15)


@pytest.mark.parametrize("widths", [np.inf, 50.0, 4.5, 1.0])
def test_noise_away_from_a_resonance_is_told_without_bias(widths):
    """129 rows of noise alone, and of a resonance over so many widths to each side: where a ratio had a pole of its own
    beside some row, it told 8 % too little of the first.
    """
    place, levels = np.linspace(-widths, widths, 129) if np.isfinite(widths) else np.linspace(-1.0, 1.0, 129), []
    curve = 700.0 / (1 + 2j * place) if np.isfinite(widths) else 0.0 * place
    for seed in range(32):
        real, imaginary = np.random.default_rng(seed).normal(size=(2, place.size))
        noisy = (curve + real + 1j * imaginary)[:, None]
        levels.append(noise_over_frequency(1e4 + place, noisy, [slice(0, place.size)]))
    assert np.mean(levels) == pytest.approx(1.0, abs=0.03)


@pytest.mark.parametrize("decay", [np.inf, 300.0])
@pytest.mark.parametrize("cycles", [0.02, 0.31])
@pytest.mark.parametrize("quadrature", [0.0, 1j])
def test_a_wave_is_not_taken_for_noise(decay, cycles, quadrature):
    """White noise of 1 in each part below a tone, steady or decaying, of few or many samples per cycle."""
    t, levels = np.arange(2000), []
    wave = 500 * np.exp(-t / decay) * np.cos(2 * np.pi * cycles * t)
    for k in range(8):
        real, imaginary = np.random.default_rng(k).normal(size=(2, 2000))
        rows = wave + real + quadrature * imaginary if quadrature else wave + real
        levels.append(noise_over_time(rows[:, None]))
    assert np.mean(levels) == pytest.approx(1.0, abs=0.03)
    assert np.std(levels) < 0.05


@pytest.mark.parametrize("rows", [15, 34])
@pytest.mark.parametrize("of", [np.asarray, np.abs])
def test_an_estimate_scatters_as_its_degrees_of_freedom_say(rows, of):
    """120 sweeps of two channels, phasors or amplitudes alone: no more than said, and no less than half of it."""
    rng, place = np.random.default_rng(rows), np.linspace(-4, 4, rows)
    curve, pieces = 1e3 / (1 + 1j * place[:, None]) * [1.0, 0.3], [slice(0, rows)]
    noise = rng.normal(size=(120, *curve.shape)) + 1j * rng.normal(size=(120, *curve.shape))
    squares = [noise_over_frequency(place, of(curve + one), pieces) ** 2 for one in noise]
    seen, said = 2 * np.mean(squares) ** 2 / np.var(squares), freedom_over_frequency(place, of(curve), pieces)
    assert 0.75 * said < seen < 3.5 * said
    assert np.mean(squares) == pytest.approx(1.0, abs=0.1 if of is np.asarray else 0.15)


@pytest.mark.parametrize("rows", [300, 1200])
@pytest.mark.parametrize("quadrature", [0.0, 1j])
def test_an_estimate_over_time_scatters_as_its_degrees_of_freedom_say(rows, quadrature):
    rng, t = np.random.default_rng(rows), np.arange(rows)
    wave = 300 * np.exp(-t / 500) * (1.0 + 0j if quadrature else np.cos(2.3 * t))
    noise = rng.normal(size=(120, rows)) + quadrature * rng.normal(size=(120, rows))
    squares = [noise_over_time((wave + one)[:, None]) ** 2 for one in noise]
    seen, said = 2 * np.mean(squares) ** 2 / np.var(squares), freedom_over_time((wave + noise[0])[:, None])
    assert 0.7 * said < seen < 3.5 * said


@pytest.mark.parametrize("of", [np.asarray, np.abs])
def test_an_estimate_from_repeats_scatters_as_its_degrees_of_freedom_say(of):
    """Four sweeps over the same twenty frequencies, phasors or amplitudes alone."""
    rng, place, rows = np.random.default_rng(0), np.tile(np.linspace(-4, 4, 20), 4), np.arange(80)
    curve = 1e3 / (1 + 1j * place[:, None])
    noise = rng.normal(size=(200, 80, 1)) + 1j * rng.normal(size=(200, 80, 1))
    squares = [noise_over_frequency(place, of(curve + one), [slice(0, 80)], [rows]) ** 2 for one in noise]
    said = freedom_over_frequency(place, of(curve), [slice(0, 80)], [rows])
    assert 0.7 * said < 2 * np.mean(squares) ** 2 / np.var(squares) < 2.0 * said
    assert np.mean(squares) == pytest.approx(1.0, abs=0.06)


@pytest.mark.parametrize("jitter", [0.0, 3e-3])
def test_a_jitter_shows_on_the_flanks_of_repeats(jitter):
    """Six sweeps over a resonance, 60 times: what is added follows the slope, and hardly ever where there is none."""
    rng, place, rows = np.random.default_rng(5), np.tile(np.linspace(-4, 4, 31), 6), np.arange(186)
    slope, found = 1e3 / (1 + place**2), []
    for _ in range(60):
        moved = place + jitter * rng.normal(size=186)
        seen = 1e3 / (1 + 1j * moved) + rng.normal(size=186) + 1j * rng.normal(size=186)
        found.append(jitter_noise(place, seen[:, None], [rows]))
    told = [one for one in found if one is not None]
    assert len(told) == (60 if jitter else 0)
    if jitter:
        assert np.mean([one[:, 0] @ slope / (slope @ slope) for one in told]) == pytest.approx(jitter, rel=0.1)


def test_the_noise_beside_a_smooth_misfit():
    """White noise of 2 beside a misfit a hundred times larger that bends over hundreds of rows."""
    smooth = 200 * np.sin(np.arange(20_000) / 400)
    rows = smooth[:, None] + 2.0 * np.random.default_rng(0).normal(size=(20_000, 3))
    np.testing.assert_allclose(noise_beside_misfit(rows), 2.0, rtol=0.04)


def test_the_gate_is_where_noise_alone_ends():
    """Three standard deviations above the mean of χ² per degree of freedom."""
    for count in (10, 1000):
        assert gate(count) == pytest.approx(1.0 + 3.0 * stats.chi2(count).std() / count, rel=1e-12)
        both = stats.f(count, 50).std()  # Fisher's distribution, where the noise was estimated with 50
        assert gate(count, freedom=50) == pytest.approx(1.0 + 3.0 * both, rel=0.16)
        assert gate(count, 4.5) == pytest.approx(1.0 + 4.5 * stats.chi2(count).std() / count, rel=1e-12)


def test_a_sound_case_has_no_warning(bench):
    assert assess(bench).warnings == ()


@pytest.mark.parametrize(
    ("name", "row", "channel"), [("sweep_x", 50, 1), ("ringdown", 100, 0), ("rate", 60, 1), ("raw", 150, 1)]
)
def test_a_wrong_digit_is_told_with_its_line(bench, name, row, channel):
    record = bench.record(name)
    field = "phasors" if np.iscomplexobj(record.readings) else "signals"
    readings = record.readings.copy()
    readings[row, channel] += 40 * NOISE
    warnings = assess(with_record(bench, name, **{field: readings})).warnings
    assert len(warnings) == 1
    assert f"{record.file}, line {record.lines[row]}: channel {'xy'[channel]}" in warnings[0]


def test_a_wrong_rate_is_told_with_its_line(bench):
    rate = bench.record("rate").rate.copy()
    rate[20] = 0.1
    (warning,) = assess(with_record(bench, "rate", rate=rate)).warnings
    assert "rate.csv, line 22: the rate lies far off" in warning


@pytest.mark.parametrize(("factor", "said"), [(-1.0, "has the other sign"), (180 / np.pi, "labelled rad/s")])
def test_a_rate_of_another_sign_or_unit_is_told(demo, factor, said):
    """Else a device mounted upside down has an "unknown effect", and degrees for radians an error of scale."""
    rate = factor * demo.record("rate").rate
    (warning,) = assess(with_record(demo, "rate", rate=rate)).warnings
    assert said in warning


@pytest.mark.parametrize("jump", [1.0, 1.0j])
def test_a_step_is_no_outlier_and_a_spike_is(jump):
    place = np.arange(60.0)
    noise = np.random.default_rng(2).normal(0, 1e-3, 60)
    assert lone_rows(place, noise + jump * (place > 30), 1e-3) == []
    assert [row for row, _ in lone_rows(place, noise + jump * (place == 30), 1e-3)] == [30]


def test_the_first_row_of_a_new_course_is_no_outlier():
    """A table that begins to turn; a digit that is wrong there still is one."""
    rate = np.maximum(np.sin((np.arange(60.0) - 29.95) / 40), 0.0)
    assert lone_rows(np.arange(60.0), rate, 0.0) == []
    rate[30] += 0.5
    assert [row for row, _ in lone_rows(np.arange(60.0), rate, 0.0)] == [30]


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("wrong", [20, 41, 61, 62])
def test_rows_at_the_same_place_are_laid_beside_their_neighbours(wrong):
    """Repeats within a sweep, one of which is wrong, or a row between them; NumPy warned of a division by zero."""
    place = np.sort(np.r_[np.linspace(-4.0, 4.0, 60), np.linspace(-4.0, 4.0, 60)[10:40:2], -4.0])
    rng = np.random.default_rng(6)
    values = 1e3 / (1 + 1j * place) + rng.normal(size=76) + 1j * rng.normal(size=76)
    assert lone_rows(place, values, 1.0) == lone_rows(-place, values, 1.0) == []
    values[wrong] += 80.0
    assert [row for row, _ in lone_rows(place, values, 1.0)] == [wrong]


def test_a_wrong_row_beside_a_close_one_is_told_itself():
    """A reading 30 % too large a tenth of a step past its neighbour: the row after next lies farther off the cubic
    through its own neighbours, of which it is one.
    """
    place = np.array([-13.0, -12.0, -11.3, -10.8, -10.55, -10.51, -10.0, -9.65, -9.29, -9.0, -8.5, -8.0, -7.0])
    values = 100.0 / (1 + 1j * place)
    values += 1e-3 * np.random.default_rng(7).normal(size=13)
    values[5] *= 1.3
    assert [row for row, _ in lone_rows(place, values, 1e-3)] == [5]


def test_noise_alone_has_no_outlier():
    rng = np.random.default_rng(3)
    assert [lone_rows(np.arange(500.0), rng.normal(size=500), 1.0) for _ in range(50)] == [[]] * 50


def narrow_modes(folder, grids, wrong=()):
    """Two axes with a little in common at 11.3 and 11.6 kHz, 3 Hz wide, swept over grids by axis; `wrong` adds 10 mV
    to rows (file, row) of channel x.
    """
    files = []
    for number, (axis, f) in enumerate(grids):
        rng, shape = np.random.default_rng(number), [1.0 / ((c**2 - f**2) / c + 3j * f / c) for c in (11300.0, 11600.6)]
        mix = np.array([[1.0, 0.02], [0.02, 1.0]])
        z = np.stack([mix[0, axis] * shape[0] + 0.02 * shape[1], mix[1, axis] * shape[1] + 0.02 * shape[0]], axis=1)
        z += 1e-5 * (rng.normal(size=z.shape) + 1j * rng.normal(size=z.shape))
        z[[row for file, row in wrong if file == number], 0] += 0.01
        files.append(folder / f"drive_{'xy'[axis]}_{number}.csv")
        rows = [
            ",".join(f"{v:.9e}" for v in (a, b.real, b.imag, c.real, c.imag)) for a, (b, c) in zip(f, z, strict=True)
        ]
        files[-1].write_text("\n".join(["f [Hz],Vx_I [V],Vx_Q [V],Vy_I [V],Vy_Q [V]", *rows]) + "\n")
    import_case(files, case := folder / f"case_{len(wrong)}")
    return [w for w in assess(load_case(case)).warnings if "digit" in w]


COARSE = np.linspace(11250.0, 11650.0, 81)
DENSE = [np.unique(np.r_[COARSE, centre + np.linspace(-6.0, 6.0, 41)]) for centre in (11300.0, 11600.6)]


@pytest.mark.parametrize(
    "grids", [list(enumerate(DENSE)), [*[(0, DENSE[0])] * 2, (1, COARSE)]], ids=["other axis", "other sweep"]
)
def test_a_resonance_that_another_sweep_shows_is_no_wrong_digit(grids, tmp_path):
    """Rows 5 Hz apart over the other axis' resonance, where one stands alone; what is wrong is told all the same."""
    assert narrow_modes(tmp_path, grids) == []
    (told,) = narrow_modes(tmp_path, grids, wrong=[(0, 90)])
    assert told.startswith("drive_x_0.csv, line 92: channel x")


@pytest.mark.parametrize("factor", [0.1, 10.0])
def test_a_wrong_declared_noise_is_told(bench, factor):
    (warning,) = assess(with_record(bench, "ringdown", noise_std=factor * NOISE)).warnings
    assert "declared noise" in warning


def test_records_of_two_devices_are_told(tmp_path):
    """Two sweeps of one resonator, which was a little warmer in the second, and one of another."""
    files = []
    for number, centre in enumerate((4000.0, 4020.0, 9000.0)):
        f = np.linspace(0.97, 1.03, 41) * centre
        z = 1e-3 / (1 - (f / centre) ** 2 + 1j * f / centre / 150)
        rows = [f"{a:.4f},{b.real:.9e},{b.imag:.9e}" for a, b in zip(f, z, strict=True)]
        files.append(tmp_path / f"sweep_{number}.csv")
        files[-1].write_text("\n".join(["f [Hz],X [V],Y [V]", *rows]) + "\n")
    import_case(files[:2], tmp_path / "one")
    import_case(files, tmp_path / "two")
    assert not [w for w in assess(load_case(tmp_path / "one")).warnings if "one device" in w]
    (told,) = [w for w in assess(load_case(tmp_path / "two")).warnings if "one device" in w]
    assert told.startswith("`sweep_0` resonates at 4 kHz and `sweep_2` at 9 kHz")


@pytest.mark.parametrize("name", ["sweep_x", "ringdown"])
def test_exchanged_channels_are_told(bench, name):
    record = bench.record(name)
    field = "phasors" if np.iscomplexobj(record.readings) else "signals"
    (warning,) = assess(with_record(bench, name, **{field: record.readings[:, ::-1]})).warnings
    assert "as labelled" in warning


def test_short_drives_dwells_and_records_are_told(bench):
    (warning,) = assess(with_record(bench, "ringdown", drive_duration=0.01)).warnings
    assert "lasts less than 5 time constants" in warning
    sweep = bench.record("sweep_x")
    clocked = with_record(bench, "sweep_x", time=0.01 * np.arange(sweep.rows))
    (warning,) = assess(clocked).warnings
    assert "declared settled" in warning
    assert assess(with_record(clocked, "sweep_x", settled=False)).warnings == ()


@pytest.mark.skipif(not CASES.is_dir(), reason="the public cases lie beside the repository and are not there")
@pytest.mark.parametrize("name", ["P1", "P4", "silverbox"])
def test_public_cases_have_the_noise_they_declare_and_no_outlier(name):
    assert assess(load_case(CASES / name)).warnings == ()


def test_a_resonance_without_a_width_is_told_as_that():
    """Sweeps at several drives that were all taken for one showed "87.3569999999999993 kHz" and 8.747e+15."""
    omega = 2 * np.pi * 87_357.0
    assert _number("resonance", omega, 8.747e15) == "87.357 kHz"
    assert _number("quality_factor", 8.747e15, 8.747e15).startswith("no width of the resonance")


def test_what_the_weakest_sweeps_show_stands_beside_the_design(tmp_path):
    """A lock-in whose reference is 1.7° off and 0.4 µs late, at 41.3 kHz; and a design that is not this device's."""
    case = load_case(driven.write(tmp_path))
    said = beside_design(case)
    assert said[0] == "resonance: the records show 41.3 kHz, as `[design]` has it."
    assert said[1].startswith("quality_factor: the records show ")
    assert not [sentence for sentence in said if "outside" in sentence]
    (turn,) = [float(found) for sentence in said for found in re.findall(r"about ([+-].*?)°", sentence)]
    assert turn == pytest.approx(-np.degrees(driven.PHASE + driven.RESONANCE * driven.DELAY), abs=1.5)
    gain = said[2]
    assert gain.startswith("static_gain: the records show 0.00")
    seen, meant = re.search(r"a mass of (\S+) kg\), the design \S+ \((\S+) kg\)", gain).groups()
    assert (float(seen), float(meant)) == (pytest.approx(driven.MASS, rel=0.1), pytest.approx(driven.MASS, rel=0.01))
    text = (tmp_path / "case.toml").read_text()
    open_ = re.sub(r"resonance = .*\n", "", text)
    (tmp_path / "case.toml").write_text(open_)
    assert gain.split(",")[0] == beside_design(load_case(tmp_path))[2].split(",")[0], "the mass alone tells the gain"
    (tmp_path / "case.toml").write_text(open_.replace("1.6, unit", "3.2, unit"))
    assert beside_design(load_case(tmp_path))[2].endswith("which lies outside its tolerance.")
    (tmp_path / "case.toml").write_text(text.replace("8000, unit", "2000, unit"))
    (wrong,) = [sentence for sentence in beside_design(load_case(tmp_path)) if "outside" in sentence]
    assert wrong.startswith("quality_factor: the records show ")
    assert wrong.endswith("the design 2000, which lies outside its tolerance.")


@pytest.mark.parametrize("start", ["rest", "unknown"])
def test_the_lines_of_a_chirp_tell_no_phase_aside_of_the_resonance(start, tmp_path):
    """They are spectra under a window, of a force that is nearly none where it did not dwell: 43° where truth is 0°."""
    time = np.arange(6000) / 4e4
    force = 0.5 * signal.chirp(time, 2500.0, time[-1], 6000.0)
    omega = 2 * np.pi * 4000.0
    _, moved, _ = signal.lsim(([0.02 * omega**2], [1.0, omega / 50.0, omega**2]), force, time)
    seen = moved + 5e-4 * np.random.default_rng(3).normal(size=6000)
    rows = (f"{t:.9g},{u:.9g},{v:.9g}" for t, u, v in zip(time, force, seen, strict=True))
    (tmp_path / "chirp.csv").write_text("\n".join(["t [s],u [V],x [V]", *rows]) + "\n")
    (tmp_path / "case.toml").write_text(f"""schema = "memsgyro-case/1"
name = "chirp"
device = "resonator"
[[experiment]]
name = "chirp"
kind = "time_record"
file = "chirp.csv"
hold = "linear"
start = "{start}"
""")
    said = beside_design(load_case(tmp_path))
    assert [sentence.split(":")[0] for sentence in said] == ["resonance", "quality_factor"]


def test_numbers_that_import_wrote_are_no_design(tmp_path):
    """They were estimated from the decay itself, and `check` said "as `[design]` has it"."""
    rng, t = np.random.default_rng(1), np.arange(4000) * 5e-3
    z = np.exp((-1.0 + 2j * np.pi * 7.0) * t) + 1e-3 * (rng.normal(size=t.size) + 1j * rng.normal(size=t.size))
    lines = ["t [s],X [V],Y [V]", *(f"{s:.9g},{v.real:.9g},{v.imag:.9g}" for s, v in zip(t, z, strict=True))]
    (tmp_path / "a.csv").write_text("\n".join(lines) + "\n")
    found = import_case([tmp_path / "a.csv"], tmp_path / "case", reference="4 kHz").case
    said = beside_design(found)
    assert said[0].startswith("resonance: the records show 4.007")
    assert not any("design" in sentence for sentence in said)
    toml = tmp_path / "case" / "case.toml"
    lines = toml.read_text().splitlines()
    lines = ['resonance = { value = 4007.0, tolerance = 0.02, unit = "Hz" }' if one.startswith("resonance") else one
             for one in lines]  # fmt: skip
    toml.write_text("\n".join(lines) + "\n")
    assert "design" in beside_design(load_case(tmp_path / "case"))[0]


@pytest.mark.parametrize(
    ("tolerance", "words"),
    [
        (0.5, "lies outside its tolerance: a drive of 1.13e-07 N/V, within its tolerance, would agree"),
        (0.02, "lies outside its tolerance."),
    ],
)
def test_a_scale_that_would_agree_with_the_mass_is_named(tolerance, words):
    """The right mass was accused, and a strength in newtons told 13 % off, where the drive was known to half of it."""
    case = SimpleNamespace(
        drive=Drive("V", 1e-7, tolerance),
        readout=SimpleNamespace(tolerance=0.03, scale=1e5, unit="V"),
        words=SimpleNamespace(displacement="m"),
    )
    assert f"lies outside its tolerance{_scale_that_agrees(case, 1.13)}.".startswith(words)
