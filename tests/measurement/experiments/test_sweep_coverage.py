"""What a sweep does not show of its resonance is said; a sweep that shows it is not complained of."""

from contextlib import nullcontext
from dataclasses import replace

import numpy as np
import pytest
from bench_case import ONE_AXIS, RESONATOR, bench

import memsgyro_jax as mg
from memsgyro_jax.measurement.experiments.sweep_coverage import (
    at_one_gain,
    peaks_not_seen,
    place_in_band,
    sudden_fall,
    ways_swept,
)


CASE = """schema = "memsgyro-case/1"
name = "ranges"
device = "resonator"
[readout]
quantity = "displacement"
[[experiment]]
name = "sweep"
kind = "frequency_sweep"
file = "sweep.csv"
"""
HERTZ = np.linspace(1000.0, 1020.0, 81)
WHOLE = slice(0, 81)


def response(resonance, quality_factor, hertz=HERTZ):
    return 1.0 / np.abs(resonance**2 - hertz**2 + 1j * hertz * resonance / quality_factor)


def said(size, sweeps=(WHOLE,), hertz=HERTZ, setting=None):
    return peaks_not_seen("up.csv", hertz, size, np.ones(len(hertz)) if setting is None else setting, sweeps)


@pytest.mark.parametrize("quality_factor", [20.0, 50.0, 1000.0, 3e4])
def test_a_peak_within_the_band_needs_no_word(quality_factor):
    assert said(response(1009.3, quality_factor)) == []


@pytest.mark.parametrize(("resonance", "beyond", "end"), [(1030.0, "higher", "1.02 kHz"), (990.0, "lower", "1 kHz")])
def test_a_peak_beyond_the_band_is_asked_for(resonance, beyond, end):
    (sentence,) = said(response(resonance, 200.0))
    assert f"end of its band, {end}:" in sentence
    assert f"a sweep on to {beyond} frequencies" in sentence
    (back,) = said(response(resonance, 200.0)[::-1], hertz=HERTZ[::-1])
    assert f"a sweep on to {beyond} frequencies" in back


def test_a_fall_asks_for_the_other_direction_unless_it_was_taken():
    bent = np.where(HERTZ < 1012.0, 0.1 + (HERTZ - 1000.0) / 12.0, 0.08)
    row = sudden_fall(bent)
    assert HERTZ[row] < 1012.0 <= HERTZ[row + 1]
    (sentence,) = said(bent)
    assert "that is no fault of it, and a sweep down would show the other branch as well" in sentence
    both = np.concatenate([HERTZ, HERTZ[::-1]])
    assert said(np.concatenate([bent, bent[::-1]]), (WHOLE, slice(81, 162)), both) == []
    other = np.repeat([1.0, 2.0], 81)
    assert len(said(np.concatenate([bent, bent[::-1]]), (WHOLE, slice(81, 162)), both, other)) == 2


def test_a_range_that_changes_is_no_fall():
    phasors = 1.0 / (1010.0**2 - HERTZ**2 + 1j * HERTZ * 1010.0 / 300.0)
    (sentence,) = said(np.where(HERTZ < 1010.1, phasors, 0.1 * phasors))
    assert "times as large" in sentence
    assert "a range or a gain is changed" in sentence
    assert said(phasors) == []
    bent = np.where(HERTZ < 1012.0, -1j * (0.1 + (HERTZ - 1000.0) / 12.0), -0.08)
    (sentence,) = said(bent)
    assert "would show the other branch" in sentence


def test_the_other_direction_may_be_in_another_record():
    """At the same drive, over the place of the fall."""
    bent = np.where(HERTZ < 1012.0, 0.1 + (HERTZ - 1000.0) / 12.0, 0.08)
    whole, far = HERTZ[::-1], np.linspace(1020.0, 1013.0, 81)
    for hertz, level, left in ((whole, 1.01, 0), (whole, 2.0, 1), (HERTZ, 1.0, 1), (far, 1.0, 1)):
        elsewhere = ways_swept(hertz, np.full(81, level), (WHOLE,))
        assert len(peaks_not_seen("up.csv", HERTZ, bent, np.ones(81), (WHOLE,), elsewhere)) == left


def test_a_record_asks_its_case_for_the_other_direction():
    """A file for each direction is what instruments save."""
    case = bench(die=RESONATOR, protocol=ONE_AXIS).case
    record = case.records[0]
    rows = record.sweeps[0]
    hertz, bent = record.frequency[rows], np.where(np.arange(rows.stop) < 9, -0.2j - 0.1j * np.arange(rows.stop), 0.08)
    order = np.argsort(hertz)
    names = ("drive", "temperature", "bias_voltage", "rate", "frequency")
    kept = {name: getattr(record, name)[rows][order] for name in names}
    up = replace(record, **kept, phasors=bent[:, None], time=None, file="up.csv")
    turned = {name: values[::-1] for name, values in kept.items()}
    down = replace(record, **turned, phasors=bent[::-1, None], time=None, file="down.csv")
    assert any("a sweep down" in said for said in up.warnings(replace(case, records=(up,))))
    assert not any("other branch" in said for said in up.warnings(replace(case, records=(up, down))))


def test_a_frequency_has_the_digits_that_tell_rows_apart():
    assert place_in_band(np.linspace(1.0406e6, 1.0421e6, 151), 114) == "1.04174 MHz"
    assert place_in_band(np.array([100.0, 200.0, 300.0]), 1) == "200 Hz"


def test_ranges_that_are_changed_across_the_peak_do_not_hide_how_the_phase_turns(tmp_path):
    """Refused as a phase that falls by 18° only: between two steps of the gain there are half-power points, too."""
    hertz = np.linspace(22000.0, 22020.0, 101)
    plain = 1.0 / ((1.0 - (hertz / 22010.0) ** 2) * 4000.0 + 1j * hertz / 22010.0)
    np.testing.assert_array_equal(at_one_gain(plain), plain)
    phasors = np.where(np.abs(np.arange(101) - 51) <= 12, 0.3, 1.0) * plain
    np.testing.assert_allclose(at_one_gain(phasors), plain, rtol=0.1)
    file = tmp_path / "sweep.csv"
    for read, said in ((phasors, ""), (phasors.conj(), "must fall by about 90°")):
        table = np.column_stack([np.full(101, 0.02), hertz, read.real, read.imag])
        np.savetxt(file, table, "%.9g", ",", header="F_x [V],f [Hz],Vx_I [V],Vx_Q [V]", comments="")
        (tmp_path / "case.toml").write_text(CASE)
        with pytest.raises(mg.InputError, match=said) if said else nullcontext():
            mg.load_case(tmp_path)


@pytest.mark.parametrize("held", [2, 5])
def test_readings_that_are_held_for_some_rows_are_no_fall(held):
    """A tuning fork whose converter read anew at every second or fifth row, "as a bent resonance does"."""
    hertz = np.arange(32745.0, 32769.0, 0.2 if held == 5 else 0.6)
    read = np.repeat(hertz[held // 2 :: held], held)[: hertz.size]
    read = np.append(read, np.full(hertz.size - read.size, hertz[-1]))
    assert said(response(32758.3, 16000.0, read), (slice(0, hertz.size),), hertz) == []
