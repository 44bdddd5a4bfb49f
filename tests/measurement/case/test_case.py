"""Reading and writing measurement cases: every number arrives in SI, and comes back exactly."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from measurement.case.bench import write_bench

from memsgyro_jax.base.errors import InputError
from memsgyro_jax.measurement.case import load_case, write_case


CASES = Path(__file__).resolve().parents[4] / "shared" / "data" / "cases"


@pytest.fixture
def bench(tmp_path):
    return write_bench(tmp_path / "bench")


def assert_same_case(case, other):
    for name in ("name", "description", "device", "design", "readout", "environment", "conventions"):
        assert getattr(case, name) == getattr(other, name), name
    for record, again in zip(case.records, other.records, strict=True):
        assert type(record) is type(again)
        for field in dataclasses.fields(record):
            if field.name != "lines":
                np.testing.assert_array_equal(getattr(record, field.name), getattr(again, field.name), field.name)


def test_a_design_may_be_given_by_its_modes(bench):
    """In place of stiffness and damping; the numbers are those of the case's own ends, written out here."""
    path, w = bench / "case.toml", 2 * np.pi * 3e3
    text = path.read_text()
    for old, new in (
        ('kxx = { value = 64.0, unit = "N/m"', 'frequency_x = { value = 3.0, unit = "kHz"'),
        ('kxy = { low = 0.0, high = 1.0, unit = "N/m" }', 'quadrature = { low = -10.0, high = 30.0, unit = "deg/s" }'),
        ('dxx = { value = 3.6e-5, unit = "N*s/m"', 'quality_factor_x = { value = 90.0, unit = "1"'),
        ('dyy = { value = 4.5e-5, unit = "N*s/m"', 'quality_factor_y = { value = 80.0, unit = "1"'),
    ):
        assert text.count(old) == 1
        text = text.replace(old, new)
    path.write_text(text)
    design = load_case(bench).design
    kxx, kxy, dxx, dyy = (design[name] for name in ("kxx", "kxy", "dxx", "dyy"))
    ends = lambda *values: pytest.approx(values, rel=1e-12)  # noqa: E731
    assert (kxx.value, kxx.low, kxx.high) == ends(1.8e-7 * w**2, 0.9**3 * 1.8e-7 * w**2, 1.1**3 * 1.8e-7 * w**2)
    assert (kxy.value, kxy.low) == ends(3.6e-7 * w * np.radians(10.0), -(1.1**2) * 3.6e-7 * w * np.radians(10.0))
    assert (dxx.low, dxx.high) == ends(0.9**2 * 1.8e-7 * w / 108.0, 1.1**2 * 1.8e-7 * w / 72.0)
    assert dyy.value == pytest.approx(np.sqrt(72.0 * 1.8e-7) / 80.0, rel=1e-12)
    path.write_text(text.replace("frequency_x", "kxx = { value = 64.0, unit = 'N/m', tolerance = 0.1 }\nfrequency_x"))
    with pytest.raises(InputError, match=r"line 8, `design.frequency_x`: must not stand beside kxx"):
        load_case(bench)


def test_every_kind_is_read_in_si(bench):
    case = load_case(bench)
    assert case.channels == 2
    assert case.design["mass"].value == 1.8e-7
    assert case.design["mass"].high == pytest.approx(1.98e-7, rel=1e-12)
    assert case.design["kxy"].value == 0.5
    assert case.readout.scale == pytest.approx(0.5e6, rel=1e-12)
    assert case.environment.temperature == pytest.approx(298.15, rel=1e-12)
    sweep = case.record("sweep_x")
    assert (sweep.axis, sweep.settled, len(sweep.sweeps)) == (0, True, 2)
    assert sweep.frequency[0] == pytest.approx(2 * np.pi * 2900, rel=1e-12)
    assert set(np.round(sweep.drive * 1e9, 6)) == {20.0, 60.0}
    np.testing.assert_array_equal(sweep.bias_voltage, 10.0)
    np.testing.assert_array_equal(sweep.rate, 0.0)
    table = case.record("rate")
    assert np.max(table.rate) == pytest.approx(np.radians(100.0), rel=1e-12)
    assert (table.lock_in_cycles, table.rate_calibrated, table.has_rate) == (3, False, True)
    ring = case.record("ringdown")
    assert ring.signals.shape == (ring.rows, 2)
    assert ring.drive_frequency == pytest.approx(2 * np.pi * 3000, rel=1e-12)
    raw = case.record("raw")
    assert (raw.hold, raw.start, raw.role) == ("zero_order", "rest", "validation")
    assert raw.forces[0, 1] == pytest.approx(5e-9, rel=1e-12)
    assert raw.period == pytest.approx(2e-5, rel=1e-12)
    assert raw.lines[0] == 2


def test_the_case_prints_its_records(bench):
    printed = str(load_case(bench))
    for name in ("sweep_x", "ringdown", "rate", "raw", "validation", "2 sweeps"):
        assert name in printed


def test_an_unknown_record_names_those_there_are(bench):
    with pytest.raises(InputError, match="sweep_x, ringdown, rate, raw"):
        load_case(bench).record("sweepx")


def test_writing_and_reading_gives_the_same_numbers(bench, tmp_path):
    case = load_case(bench)
    write_case(case, tmp_path / "again")
    assert_same_case(case, load_case(tmp_path / "again"))


def test_text_survives_writing(bench, tmp_path):
    case = load_case(bench)
    record = dataclasses.replace(case.records[0], note='quotes " \\ µ \x7f and\nlines', name="a.b [c]")
    odd = dataclasses.replace(case, description="=#'", conventions={"a b": "π"}, records=(record,))
    write_case(odd, tmp_path / "odd")
    assert_same_case(odd, load_case(tmp_path / "odd"))


def test_a_case_is_not_overwritten(bench):
    with pytest.raises(InputError, match="must not hold a case yet"):
        write_case(load_case(bench), bench)


def test_a_changed_file_is_noticed_by_its_checksum(bench, tmp_path):
    write_case(load_case(bench), tmp_path / "again")
    path = tmp_path / "again" / "raw.csv"
    text = path.read_text()
    place = text.index(",", len(text) // 2) + 3
    path.write_text(text[:place] + ("1" if text[place] != "1" else "2") + text[place + 1 :])
    with pytest.raises(InputError, match=r"line \d+, `experiment.3.sha256`: .*raw.csv"):
        load_case(tmp_path / "again")


def test_amplitude_and_phase_are_the_same_phasors(bench):
    phasors = load_case(bench).record("sweep_x").phasors
    path = bench / "sweep_x.csv"
    rows = np.loadtxt(path, delimiter=",", skiprows=1)
    polar = [(np.abs(z), np.degrees(np.angle(z))) for z in (rows[:, 2] + 1j * rows[:, 3], rows[:, 4] + 1j * rows[:, 5])]
    table = np.column_stack([rows[:, :2], *polar[0], *polar[1]])
    header = "F_x [nN],f [Hz],Vx_amp [V],Vx_phase [deg],Vy_amp [V],Vy_phase [deg]"
    np.savetxt(path, table, delimiter=",", header=header, comments="", fmt="%.17g")
    np.testing.assert_allclose(load_case(bench).record("sweep_x").phasors, phasors, rtol=1e-12)


@pytest.mark.skipif(not CASES.is_dir(), reason="the public cases lie beside the repository and are not there")
@pytest.mark.parametrize("name", ["P1", "P2", "P3", "P4", "P5", pytest.param("silverbox", marks=pytest.mark.slow)])
def test_public_cases_are_read_and_written(name, tmp_path):
    case = load_case(CASES / name)
    write_case(case, tmp_path / "case")
    assert_same_case(case, load_case(tmp_path / "case"))
    assert case.device == ("resonator" if name == "silverbox" else "single_mass")
