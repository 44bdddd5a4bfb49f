"""Records that a fit has not seen: what its uncertainty moves in them is no failure, what a device lacks is; and an
effect of chance that spoils them goes.
"""

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import memsgyro_jax as mg
from memsgyro_jax.diagnosis.spoiler import without_spoiler
from memsgyro_jax.measurement.case import Case, DesignValue, Environment, FrequencySweepRecord, Readout


W, Q, G, NOISE, DRIVE = 2 * np.pi * 3000.0, 300.0, 2.0, 1e-3, 1e-3


def sweep(seed, name, role, level, gain=1.0):
    omega = W * (1 + np.linspace(-3, 3, 61) / Q)
    rng, drive = np.random.default_rng(seed), np.full(omega.size, level * DRIVE)
    noise = NOISE * (rng.standard_normal(omega.size) + 1j * rng.standard_normal(omega.size))
    seen = gain * drive * G * W**2 / (W**2 - omega**2 + 1j * omega * W / Q) + noise
    return FrequencySweepRecord(
        name=name, file=f"{name}.csv", lines=np.arange(omega.size) + 2, role=role, noise_std=NOISE, axis=0,
        settled=True, frequency=omega, drive=drive, temperature=np.full(omega.size, 298.15),
        bias_voltage=np.zeros(omega.size), rate=np.zeros(omega.size), phasors=seen[:, None],
    )  # fmt: skip


def case_of(*records):
    design = {"resonance": W, "quality_factor": Q, "static_gain": G}
    return Case(
        folder=Path("case"), name="one mode", description="", device="resonator",
        design={name: DesignValue(value, 0.9 * value, 1.1 * value) for name, value in design.items()},
        readout=Readout(1.0, None, "V"), environment=Environment(), conventions={}, records=records,
    )  # fmt: skip


@pytest.mark.parametrize("seed", range(4))
def test_a_stronger_drive_amplifies_what_the_fit_leaves_open(seed):
    """Thirty times: a strength known to its noise at the weak drive is off by thirty times that at the strong one."""
    weak, strong = sweep(seed, "weak", "fit", 1.0), sweep(100 + seed, "strong", "validation", 30.0)
    raw = mg.compare(None, case_of(weak, strong))
    (error,) = [e for e in raw.errors if e.role == "validation"]
    assert error.rms > error.gate or seed != 0, "which the rms tells as it is"
    assert raw.explained, raw.verdict


def test_what_the_fit_cannot_move_so_far_stays_a_failure():
    weak, strong = sweep(0, "weak", "fit", 1.0), sweep(100, "strong", "validation", 30.0, gain=1.05)
    assert not mg.compare(None, case_of(weak, strong)).explained


def searched(own=()):
    labels = ("cubic_stiffness x", "squeeze_film_damping x")
    told, steps = [], [SimpleNamespace(added=label, fit=label) for label in ("", *labels)]
    return SimpleNamespace(
        steps=steps, accepted=[0, 1], own=own, told=told, tell=told.append, without=lambda place: ("without", place),
        refit=lambda places, start: (places, start),
        joint=SimpleNamespace(model=SimpleNamespace(effects=[SimpleNamespace(label=label) for label in labels])),
    )  # fmt: skip


def test_an_effect_that_spoils_what_was_not_fitted_goes():
    search = searched()
    assert without_spoiler(search, lambda fit, accepted: fit == "cubic_stiffness x" and accepted == [0])
    assert search.accepted == [0]
    assert search.optimum == ([0], ("without", 1))
    assert [step.added for step in search.steps] == ["", "cubic_stiffness x"]
    assert "squeeze_film_damping x" in search.told[0]


@pytest.mark.parametrize("explained", [lambda fit, accepted: True, lambda fit, accepted: False])
def test_one_that_spoils_nothing_stays(explained):
    search = searched()
    assert not without_spoiler(search, explained)
    assert search.accepted == [0, 1]
    assert not without_spoiler(searched(own=(1,)), lambda fit, accepted: fit == "cubic_stiffness x")
