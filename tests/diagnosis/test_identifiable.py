"""What records can identify, against an independent Fisher matrix."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import memsgyro_jax as mg
from memsgyro_jax.diagnosis.identifiable import identifiable
from memsgyro_jax.measurement.case import Case, DesignValue, Environment, FrequencySweepRecord, Readout


W, Q, G, NOISE = 2 * np.pi * 3000.0, 300.0, 2.0, 1e-3


def response(parameters, omega):
    stiffness, damping, mobility = parameters
    return mobility / (stiffness - omega**2 + 1j * omega * damping)


def test_a_short_run_tells_what_a_fit_of_it_would(tmp_path):
    """Its spectrum told a start three times off in mass and damping, and the dampers' coupling to 6e-4."""
    gyro = mg.SingleMassGyro.from_modes("1 mg", ("5 kHz", "5.2 kHz"), (500, 700), quadrature="10 deg/s")
    readout, force = mg.DirectReadout(1e5, noise_density=1e-7), float(gyro.kxx) * 5e-6 / 500
    drive = mg.OpenLoop(((mg.Tone(5000.0, force), mg.Tone(5080.0, force)), (mg.Tone(5200.0, force / 2),)))
    loop = mg.ClosedLoop(gyro, readout, mg.NoObserver.for_device(gyro, readout), drive, start=(1e-6, 0.0, 0.0, 0.0))
    trace = mg.simulate(loop, np.radians(200.0), sample_rate=140e3, duration=0.03, seed=4)
    case = mg.load_case(trace.to_case(tmp_path / "case").parent)
    told = identifiable(case)[-1]
    fit = mg.fit(None, case)
    known = {e.name: e.std / abs(e.value) for e in fit.estimates}
    for name, relative in zip(told.names, told.relative, strict=True):
        if name in ("kxx/m", "kyy/m", "dxx/m", "dyy/m", "1/m"):
            assert relative == pytest.approx(known[name], rel=0.05), name
    assert told.relative[told.names.index("dxy/m")] > 0.1


@pytest.fixture(scope="module")
def case():
    omega = W * (1 + np.linspace(-3, 3, 61) / Q)
    truth = np.array([W**2, W / Q, G * W**2])
    count = omega.size
    record = FrequencySweepRecord(
        name="sweep",
        file="sweep.csv",
        lines=np.arange(count) + 2,
        role="fit",
        noise_std=NOISE,
        axis=0,
        settled=True,
        frequency=omega,
        drive=np.full(count, 1e-3),
        temperature=np.full(count, 298.15),
        bias_voltage=np.zeros(count),
        rate=np.zeros(count),
        phasors=1e-3 * response(truth, omega)[:, None],
    )
    design = {"resonance": W, "quality_factor": Q, "static_gain": G}
    return Case(
        folder=Path("case"),
        name="one mode",
        description="",
        device="resonator",
        design={name: DesignValue(value, 0.9 * value, 1.1 * value) for name, value in design.items()},
        readout=Readout(1.0, None, "V"),
        environment=Environment(),
        conventions={},
        records=(record,),
    )


def test_standard_deviations_are_those_of_the_fisher_matrix(case):
    record = case.records[0]
    truth = np.array([W**2, W / Q, G * W**2])
    columns = []
    for place in range(3):
        step = np.zeros(3)
        step[place] = 1e-6 * truth[place]
        change = response(truth + step, record.frequency) - response(truth - step, record.frequency)
        columns.append(1e-3 * change / (2e-6 * truth[place]) * truth[place] / NOISE)
    jacobian = np.concatenate([np.real(columns), np.imag(columns)], axis=1).T
    expected = np.sqrt(np.diag(np.linalg.inv(jacobian.T @ jacobian)))
    found = identifiable(case)[0]
    assert found.names[:3] == ("k/m", "d/m", "1/m")
    np.testing.assert_allclose(found.relative[:3], expected, rtol=1e-4)


def test_what_no_record_holds_is_infinite_and_named(case):
    """One phasor is two numbers for three parameters."""
    found = identifiable(replace(case, records=(case.records[0].only(np.array([20])),)))[-1]
    assert found.name == "all records"
    assert len(found.nulls) == 1
    assert np.isinf(found.relative).any()
    assert str(found).endswith(f"not held: {found.nulls[0]}")


def test_a_constant_that_a_lock_in_never_reads_is_not_said_to_be_missing(case):
    (one, every) = identifiable(case)
    assert one.names == every.names == ("k/m", "d/m", "1/m")
    assert one.nulls == every.nulls == ()
