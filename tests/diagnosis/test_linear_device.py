"""Resonance and quality factor are told right, or without a ±, where something that nobody knows acts too."""

import numpy as np
import pytest
from bench_case import ONE_AXIS, RESONATOR, bench
from lab.die import Hidden

from memsgyro_jax.base.text import beside
from memsgyro_jax.diagnosis.fit import fit_case
from memsgyro_jax.diagnosis.linear_device import linear_device


QUALITY_FACTOR = float(np.sqrt(RESONATOR.kxx * RESONATOR.mass) / RESONATOR.dxx)


def hardening(times):
    """The base model of a resonator that hardens, fitted to all drives."""
    return fit_case(bench(Hidden(cubic_stiffness_x=times * RESONATOR.kxx), 1, ONE_AXIS, RESONATOR).case)


@pytest.fixture(scope="module")
def dragged():
    return hardening(4.0)


def test_an_unexplained_device_is_that_of_its_lowest_drive(dragged):
    """Which misses the truth by no more than a few of its standard deviations."""
    wrong = linear_device(dragged, dragged, explained=True)
    assert wrong.about == ""
    found = linear_device(dragged, dragged, explained=False)
    assert (found.held, found.about) == (True, "of the lowest drive alone")
    off = [abs(device.modes[1].value - QUALITY_FACTOR) / device.modes[1].std for device in (wrong, found)]
    assert off[1] < 4.0
    assert abs(found.modes[1].value - QUALITY_FACTOR) < 0.1 * abs(wrong.modes[1].value - QUALITY_FACTOR)


def test_a_lowest_drive_that_is_not_explained_either_has_no_standard_deviation():
    fit = hardening(40.0)
    found = linear_device(fit, fit, explained=False)
    assert not found.held
    assert all(np.isnan(mode.std) for mode in found.estimates)
    assert all("about" in line and "±" not in line for line in found.told)


def test_one_drive_alone_is_told_without_a_standard_deviation(dragged, monkeypatch):
    monkeypatch.setattr("memsgyro_jax.diagnosis.linear_device.lowest_drive", lambda fit: None)
    found = linear_device(dragged, dragged, explained=False)
    assert (found.held, found.whence) == (False, "")
    assert found.about.startswith("without ±")


def test_couplings_are_told_beside_the_modes():
    """Of a device that the base model explains with their standard deviations, of none that it does not."""
    fit = fit_case(bench().case)
    kxy, dxy = (next(e for e in fit.estimates if e.name == name) for name in ("kxy/m", "dxy/m"))
    *_, said = linear_device(fit, fit, explained=True).told
    told = [f"{e.name} {beside(e.value, e.std)} ± {e.std:.2g} {e.unit}" for e in (kxy, dxy)]
    assert said == f"coupling of the axes: {', '.join(told)}"
    assert not any("coupling" in line for line in linear_device(hardening(0.0), hardening(0.0), explained=True).told)
