"""What the tolerances of scales leave unsure of numbers in SI."""

from dataclasses import replace

import pytest
from lab import driven

import memsgyro_jax as mg
from memsgyro_jax.measurement.calibration import (
    calibration_share,
    calibration_text,
    length_of_records,
    per_second,
    unit_of_records,
    units_of_records,
)
from memsgyro_jax.measurement.declared import Readout


@pytest.fixture(scope="module")
def case(tmp_path_factory):
    return mg.load_case(driven.write(tmp_path_factory.mktemp("case"), rows=11))


def test_scales_move_numbers_by_their_powers(case):
    """Without a declared mass: newtons follow the drive, metres the read-out, and what is in volts neither."""
    free = replace(case, design={k: v for k, v in case.design.items() if k != "static_gain"})
    assert calibration_share(free, "N") == pytest.approx(0.05)
    assert calibration_share(free, "m") == pytest.approx(0.03)
    assert calibration_share(free, "N/m³") == pytest.approx((0.05**2 + (3 * 0.03) ** 2) ** 0.5)
    assert calibration_share(free, "1/kg") == pytest.approx((0.05**2 + 0.03**2) ** 0.5)
    assert calibration_share(free, "V/N") == pytest.approx(0.05)
    assert calibration_share(free, "rad²/s²") == calibration_share(free, "V") == calibration_share(free, "s") == 0.0


def test_without_scales_a_unit_is_that_of_the_records(case):
    bare = replace(case, readout=Readout(1.0), drive=None)
    shown = {unit: unit_of_records(bare, unit) for unit in ("N/m³", "N·s²/m²", "1/m", "rad²/s²", "1/kg", "N/(m·V²)")}
    assert [*shown.values()] == ["V/V³", "V·s²/V²", "1/V", "rad²/s²", "V/(V·s²)", "V/(V·V²)"]
    plain = replace(bare, readout=Readout(1.0, unit="1", displacement="1"))
    shown = {
        unit: unit_of_records(plain, unit) for unit in ("N/m³", "N·s²/m²", "1/m", "rad²/s²", "1/kg", "N/(m·V²)", "m")
    }
    assert [*shown.values()] == ["V", "V·s²", "1", "rad²/s²", "1/(V·s²)", "V/(V²)", "1"]
    assert unit_of_records(replace(bare, readout=case.readout), "N/m³") == "V/m³"
    assert unit_of_records(case, "N/m³") == "N/m³"


@pytest.mark.parametrize(
    ("readout", "length", "speed", "cubic", "background", "clipped"),
    [
        (Readout(1.0, None, "A", 1, "A*s"), "C", "A", "V/C³", "A", "1/A"),
        (Readout(1.0, None, "V", 1, "V*s"), "V·s", "V", "V/(V·s)³", "V", "1/V"),
        (Readout(1.0, None, "m/s", 1, "m"), "m", "m/s", "V/m³", "m/s", "1/(m/s)"),
    ],
)
def test_what_a_read_out_shows_has_a_plain_unit(case, readout, length, speed, cubic, background, clipped):
    """Of a current "V/(A·s)³", "2e-06 A*s/s", k3/k1 in "1/A*s²" and a background in V were told."""
    told = replace(case, readout=readout, drive=None)
    assert length_of_records(told) == length
    assert per_second(length) == speed
    assert [unit_of_records(told, unit) for unit in ("N/m³", "V", "1/V")] == [cubic, background, clipped]
    assert unit_of_records(told, "N/(m·V²)").endswith("·V²)"), "of a bias"
    assert f"m stands for {length}" in units_of_records(told)


def test_a_declared_mass_holds_the_product_of_the_scales(case):
    assert 0.0 < calibration_share(case, "1/kg") < (0.05**2 + 0.03**2) ** 0.5
    exact = replace(case, readout=replace(case.readout, tolerance=0.0), drive=replace(case.drive, tolerance=0.0))
    assert calibration_share(exact, "1/kg") == 0.0


def test_tolerances_are_kept_in_files_and_said(case, tmp_path):
    assert "down_500mV  frequency_sweep  -     11    500 mV  " in str(case), "the drive as it was set"
    assert calibration_text(case) == "Calibration: read-out 3.1e+05 V/m ± 3 %, drive 1.6e-09 N/V ± 5 %."
    mg.write_case(case, tmp_path / "again")
    again = mg.load_case(tmp_path / "again")
    assert again.readout.tolerance == 0.03
    assert calibration_share(again, "N/m³") == pytest.approx(calibration_share(case, "N/m³"))


def test_a_wrong_table_is_told_in_its_own_numbers(case):
    path = case.folder / "case.toml"
    text = path.read_text()
    path.write_text(text.replace('"nN/V", tolerance = 0.05', '"nN/V", sure = 0.05'))
    with pytest.raises(mg.InputError, match=r'example { value = 1.6, unit = "nN/V" }, without sure'):
        mg.load_case(case.folder)
    path.write_text(text.replace("tolerance = 0.05 }\n\n", "tolerance = 5 }\n\n"))
    with pytest.raises(mg.InputError, match="must have a relative `tolerance` from 0 to 1"):
        mg.load_case(case.folder)
    path.write_text(text)
