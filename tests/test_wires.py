"""Measured vibrating wires, which lie beside the repository: what sweeps end in, from the file as it was saved."""

import numpy as np
import pytest

import memsgyro_jax as mg
from memsgyro_jax.diagnosis.fit import fit_case
from memsgyro_jax.diagnosis.instrument import instrument_terms
from memsgyro_jax.diagnosis.law import draw_law
from memsgyro_jax.diagnosis.law_fit import fit_law


pytestmark = pytest.mark.slow


@pytest.fixture
def wire(shared, tmp_path):
    def load(number):
        return mg.import_case([shared / f"data/real/vibrating_wire/example{number}.csv"], tmp_path / "case").case

    return load


def test_of_a_linear_wire_the_instrument_alone_is_told(wire):
    """Background and phase alone give the width that others found, and 7.5 times the noise in χ²: each row holds 13 %
    of the one before, which makes the resonance look wider.
    """
    found = mg.diagnose(None, wire(1))
    assert (found.verdict, found.accepted) == ("instrument_only", ())
    assert found.final.chi2_per_dof == pytest.approx(1.0, abs=0.1)
    known = [t for t in instrument_terms(found.case) if t.label in ("lock_in_background", "reference_phase")]
    for fit, width in ((found.final, 65.86), (fit_case(found.case, known), 66.67)):
        device = fit.model.device
        assert np.sqrt(device.stiffness[0]) / (2 * np.pi) == pytest.approx(3966.73, abs=0.16)
        assert device.damping[0] / (2 * np.pi) == pytest.approx(width, abs=0.32)


def test_of_a_wire_whose_drives_rise_in_time_none_is_found_and_the_first_is_to_be_repeated(wire):
    """Drifts of frequency, width, gain and phase from one sweep to the next are no explanation: a sweep bends within
    itself, alike at every drive that is twice as high by four times as much. What bends it, the catalogue does not
    explain to the noise either.
    """
    case = wire(2)
    found = mg.diagnose(None, case)
    assert found.verdict in ("unknown_effect", "partly_explained")
    assert "repeat the first drive at the end" in str(found)
    assert not any(np.isfinite(a.std).any() for a in found.accepted)
    drifts = ("reference_phase", "lock_in_background", "lock_in_time", "frequency_offset")
    drifts += ("damping_drift", "gain_drift", "phase_drift")
    known = [t for t in instrument_terms(case) if t.label in drifts]
    assert fit_case(case, known).chi2_per_dof > 4 * found.final.chi2_per_dof


def test_the_law_of_a_wire_with_hysteresis_leaves_less_than_a_cubic_spring(wire, tmp_path):
    law = draw_law(fit_case(wire(3)))
    assert len(law.terms) <= 3
    after = fit_law(law, law.write(tmp_path / "law.py"))
    left = after.case.records[0].readings - after.predicted(0)
    assert np.sqrt(np.nanmean(np.abs(left) ** 2)) < 2.41e-7
