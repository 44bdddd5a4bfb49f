"""Operating points: a rate table stopped at rate after rate, against the closed form of two coupled oscillators."""

from dataclasses import replace

import numpy as np
import pytest

import memsgyro_jax as mg
from memsgyro_jax.app.report.diagnosis_page import diagnosis_page
from memsgyro_jax.base.errors import InputError
from memsgyro_jax.measurement.case import write_case
from memsgyro_jax.measurement.linear_start import starting_device
from memsgyro_jax.measurement.readings import model_of, readings_of


RATES = np.array([0, 50, 100, 150, 200, 150, 100, 50, 0, -50, -100, -150, -200, -150, -100, -50, 0.0])  # deg/s
DRIVE_HZ, SENSE_HZ, VOLTS, FORCE, MASS = 9312.7, 11200.0, 2e6, 60e-9, 1e-8
HEADER = "Rate [deg/s];X1 [V];Y1 [V];X2 [V];Y2 [V]"


def phasors(hertz, rate=0.0, axis=0):
    """Volts of both channels of a device that is driven along `axis` and turns at `rate` [rad/s]."""
    (wx, wy), w = 2 * np.pi * np.array([DRIVE_HZ, SENSE_HZ]), 2 * np.pi * hertz
    coriolis = 2j * w * rate
    push = np.array([
        [wx**2 - w**2 + 1j * w * wx / 5000, 2e5 - coriolis], [2e5 + coriolis, wy**2 - w**2 + 1j * w * wy / 1500]
    ])  # fmt: skip
    return VOLTS * np.linalg.solve(push, FORCE / MASS * np.eye(2)[axis])


def files(folder, scale=1.0, noise=2e-6, seed=0):
    """The files of two sweeps, and of a table that turns `scale` times as fast as it is set to."""
    random = np.random.default_rng(seed)

    def table(header, first, seen):
        seen = seen + noise * (random.normal(size=seen.shape) + 1j * random.normal(size=seen.shape))
        rows = np.stack([first, *seen.view(float).T], axis=1)
        return "\n".join([header, *(";".join(f"{v:.10g}" for v in row) for row in rows)]) + "\n"

    for axis, (centre, span) in enumerate(((DRIVE_HZ, 10.0), (SENSE_HZ, 40.0))):
        hertz = centre + np.linspace(-span, span, 81)
        seen = np.array([phasors(f, axis=axis) for f in hertz])
        (folder / f"sweep_{'xy'[axis]}.csv").write_text(table(HEADER.replace("Rate [deg/s]", "f [Hz]"), hertz, seen))
    seen = np.array([phasors(DRIVE_HZ, scale * np.radians(rate)) for rate in RATES])
    (folder / "static.csv").write_text(table(HEADER, RATES, seen))
    return [folder / f"{name}.csv" for name in ("sweep_x", "sweep_y", "static")]


def imported(folder, **more):
    given = {"drive": ("60 nN",), "axis": ("x", "y", "x"), "reference": "9312.7 Hz"}
    return mg.import_case(files(folder, **more), folder / "case", **given).case


def test_a_table_of_rates_without_a_clock_is_imported_as_operating_points(tmp_path):
    case = imported(tmp_path)
    static = case.records[2]
    assert (static.kind, static.axis, static.rows) == ("operating_points", 0, 17)
    np.testing.assert_allclose(np.degrees(static.rate), RATES, atol=1e-9)
    assert static.drive_frequency == pytest.approx(2 * np.pi * DRIVE_HZ)
    assert "over rate" in static.extent


def test_without_the_frequency_it_says_how_to_give_it(tmp_path):
    with pytest.raises(InputError, match="--reference"):
        mg.import_case(files(tmp_path)[2:], tmp_path / "case", drive=("60 nN",), axis=("x",))


def test_a_table_at_one_frequency_alone_tells_no_device(tmp_path):
    """One whose damping was next to none was made up of it."""
    with pytest.raises(
        InputError, match=r"must give frequency_x.*no record that may be fitted shows a clear resonance"
    ):
        mg.import_case(files(tmp_path)[2:], tmp_path / "case", drive=("60 nN",), axis=("x",), reference="9312.7 Hz")


def test_a_rate_without_a_unit_is_refused(tmp_path):
    path = files(tmp_path)[2]
    path.write_text(path.read_text().replace("Rate [deg/s]", "Rate"))
    with pytest.raises(InputError, match="must have its unit"):
        mg.import_case([path], tmp_path / "case", drive=("60 nN",), axis=("x",), reference="9312.7 Hz")


def test_a_written_case_reads_the_same(tmp_path):
    case = imported(tmp_path)
    write_case(case, tmp_path / "again")
    again = mg.load_case(tmp_path / "again").records[2]
    before = case.records[2]
    for name in ("rate", "phasors", "drive", "temperature", "bias_voltage"):
        np.testing.assert_allclose(getattr(again, name), getattr(before, name), rtol=1e-12)
    assert again.drive_frequency == pytest.approx(before.drive_frequency, rel=1e-14)


def test_rows_at_one_setting_are_refused(tmp_path):
    case = imported(tmp_path)
    again = tmp_path / "again"
    write_case(case, again)
    toml = (again / "case.toml").read_text().splitlines()
    (again / "case.toml").write_text("\n".join(line for line in toml if not line.startswith("sha256")) + "\n")
    path = again / "static.csv"
    lines = [line.split(",") for line in path.read_text().splitlines()]
    place = lines[0].index("rate [rad/s]")
    path.write_text("\n".join(",".join(part for i, part in enumerate(line) if i != place) for line in lines) + "\n")
    with pytest.raises(InputError, match="must be a column that varies"):
        mg.load_case(again)


@pytest.mark.parametrize("rates", ["repeated", "single"])
def test_its_noise_is_told_by_its_rows(tmp_path, rates):
    """By those of one rate where there are enough, else by what is smooth over the rate."""
    static = imported(tmp_path).records[2]
    if rates == "single":
        some = np.unique(static.rate, return_index=True)[1]
        names = ("lines", "rate", "phasors", "drive", "temperature", "bias_voltage")
        static = replace(static, **{name: getattr(static, name)[some] for name in names})
    smooth, random, found = np.outer(static.rate, [1.0, -2.0j]), np.random.default_rng(7), []
    for _ in range(200):
        white = random.normal(size=(*smooth.shape, 2)) @ [1.0, 1j]
        found.append(replace(static, phasors=smooth + white).estimated_noise() ** 2)
    spread = np.sqrt(2.0 / static.estimated_freedom())
    assert np.mean(found) == pytest.approx(1.0, abs=0.1)
    assert np.std(found) < 1.3 * spread  # no surer than it is


def test_the_bench_predicts_the_closed_form(tmp_path):
    """The device of the sweeps, without noise, shows at every rate what the formula says."""
    case = imported(tmp_path, noise=1e-12)
    fitted = mg.fit(None, case)
    (static,) = [i for i, record in enumerate(case.records) if record.kind == "operating_points"]
    expected = np.array([phasors(DRIVE_HZ, np.radians(rate)) for rate in RATES])
    np.testing.assert_allclose(fitted.predicted(static), expected, rtol=0, atol=1e-9 * np.abs(expected).max())


def test_every_second_row_is_fitted_and_a_calibrated_rate_is_trusted(tmp_path):
    case = imported(tmp_path)
    mine = [r for r in readings_of(case) if 2 in r.record]
    assert [int(np.sum(r.record == 2)) for r in mine] == [9, 8]
    assert [r.fitted for r in mine] == [True, False]
    assert not np.any(mine[0].experiment.surroundings.rate_trusted)
    write_case(case, tmp_path / "again")
    path = tmp_path / "again" / "case.toml"
    path.write_text(path.read_text().replace('rate_reference = "table"', 'rate_reference = "calibrated"'))
    again = mg.load_case(tmp_path / "again")
    mine = [r for r in readings_of(again) if 2 in r.record]
    assert np.all(mine[0].experiment.surroundings.rate_trusted == 1)
    model = model_of(again, starting_device(again))
    assert np.isfinite(mine[0].experiment.predict(model)).all()


def test_further_experiments_repeat_points_and_no_band(tmp_path):
    (mine, _) = [r for r in readings_of(imported(tmp_path)) if 2 in r.record]
    said = [text for text, _ in mine.experiment.proposals("static")]
    assert said[0] == "repeat `static`"
    assert "repeat `static` at rates of -200 deg/s and 200 deg/s, the ends of what was recorded" in said
    assert not any("band" in text for text in said)


@pytest.mark.slow
def test_a_table_that_turns_too_fast_is_found(tmp_path):
    found = mg.diagnose(None, imported(tmp_path, scale=1.05))
    assert found.verdict == "found"
    page = diagnosis_page(found).html()
    assert "rate [rad/s]" in page
    (one,) = found.accepted
    assert one.name == "rate_scale_error"
    assert abs(one.estimate[0] - 0.05) < 3.5 * one.std[0]


@pytest.mark.slow
def test_a_table_that_turns_as_it_is_set_lacks_nothing(tmp_path):
    assert mg.diagnose(None, imported(tmp_path)).verdict == "nothing_missing"


def test_a_device_mounted_upside_down_is_named(tmp_path):
    case = imported(tmp_path, scale=-1.0)
    assert any("has the other sign" in sentence for sentence in mg.assess(case).warnings)


def test_what_is_assumed_of_several_tables_is_told_once(tmp_path):
    sweep_x, sweep_y, static = files(tmp_path)
    further = tmp_path / "further.csv"
    further.write_text("\n".join(static.read_text().splitlines()[:10]).replace("\n0;", "\n1;") + "\n")
    found = mg.import_case(
        [sweep_x, sweep_y, static, further], tmp_path / "case", drive=("60 nN",), axis=("x", "y", "x", "x"),
        reference="9312.7 Hz",
    )  # fmt: skip
    assert "(all operating points)" in str(found)
