"""Are plant, layout and circuit as printed? Thesis 1.2, 2.1, 3.1 to 3.4, claims T1 to T4.

Tables 5.1 and 5.2 by their modes and couplings, what the simplified equations leave out, what springs and films make of
errors of the process, and the offsets of Table 5.3.
"""

import dataclasses
import inspect

import numpy as np
from _common import HOLDS, PARTLY, Report

import memsgyro_jax as mg
from memsgyro_jax.base import runtime
from memsgyro_jax.device.geometry.springs import in_series
from memsgyro_jax.device.gyro import Inertial


runtime.configure()

PLACE = "thesis 1.2, 2.1, 3.1 to 3.4"
ANSWERS = ("T1", "T2", "T3", "T4")
DRAWN = {"length": 300e-6, "width": 3e-6, "thickness": 5e-6, "young": 160e9}


def change(make, **errors) -> float:
    """Relative change of `make(beam)` by relative errors of the drawing."""
    wrong = DRAWN | {name: DRAWN[name] * (1.0 + error) for name, error in errors.items()}
    return float(make(mg.geometry.Beam(**wrong)) / make(mg.geometry.Beam(**DRAWN)) - 1.0)


def with_frame(gyro):
    """The same gyro with all terms of (2.4)."""
    names = [field.name for field in dataclasses.fields(gyro) if field.name not in ("rotating_frame", "dyx")]
    known = inspect.signature(type(gyro)).parameters
    return type(gyro)(**{name: getattr(gyro, name) for name in names if name in known}, rotating_frame=True)


def folded(beam):
    """(1.6), legs of equal length."""
    return in_series(2.0 * beam.guided, 2.0 * beam.guided)


def modes(report: Report) -> None:
    for row, gyro, printed, table in (("T1", mg.SingleMassGyro.chi2010(), (2893.0, 3758.0), "5.1"),
                                      ("T2", mg.DualMassGyro.chi2010(), (3000.0, 3674.0), "5.2")):  # fmt: skip
        full = with_frame(gyro)
        found = mg.mode_frequencies(gyro)
        for claimed, value in zip(printed, found, strict=True):
            report.row(f"Table {table}: mode [Hz]", claimed, float(value))
        rest, turning = (full.dynamics(Inertial(rate=rate)) for rate in (0.0, 10.0))
        stiff = np.abs(np.asarray(turning.stiffness, float) - np.asarray(rest.stiffness, float)).max()
        left_out = float(stiff / np.asarray(rest.stiffness, float).max())
        coriolis = np.asarray(turning.coriolis, float)
        report.row(f"Table {table}: Ω² beside the stiffness at 10 rad/s", "left out", left_out)
        report.row(
            f"Table {table}: Coriolis per velocity at 10 rad/s [1/s]", 20.0, float(np.abs(coriolis).max()), "2 Ω"
        )
        report.answer(
            row,
            claimed=f"modes at {printed[0] / 1e3:.3f} and {printed[1] / 1e3:.3f} kHz from Table {table}; Ω² and the "
            "rest of (2.4) may be left out",
            obtained=f"{found[0]:.1f} and {found[1]:.1f} Hz; Ω² changes the stiffness by {left_out:.1e} at 10 rad/s; "
            "the device has both forms",
            reading="not needed",
            verdict=HOLDS,
            why="The table gives the printed modes, and nothing that is left out reaches 1 ppm of the stiffness.",
        )


def layout(report: Report) -> None:
    thick = change(folded, thickness=0.1)
    wide = change(folded, width=0.1)
    report.row("folded spring, 10 % thicker: stiffness", 0.1, thick, "(1.6)")
    report.row("folded spring, 10 % wider legs: stiffness", "-", wide, "grows as its cube, which is not said")
    size, gap, omega = 400e-6, 2e-6, 2.0 * np.pi * 3000.0
    film = float(mg.geometry.squeeze_film(size, size, gap, omega, 101325.0).damping)
    sigma, tau = 12.0 * 1.82e-5 * size**2 * omega / (101325.0 * gap**2), 1.0
    first = 64.0 * sigma * 101325.0 * size**2 / (np.pi**6 * omega * gap)
    terms = [first * square / (square**2 + sigma**2 / np.pi**4) for square in (1.0 + (1.0 + tau) ** 2, 1.0 + tau**2)]
    report.row(
        "squeeze film, (1.9) as printed over the series", 1.0, terms[0] / film, f"400 µm square, σ = {sigma:.2f}"
    )
    report.row("  with 1 + τ² for 1 + (1 + τ)²", 1.0, terms[1] / film, "one term of the series")
    legs = ((0.0, 0.0), (200e-6, 0.0), (200e-6, 150e-6))
    exact = float(mg.geometry.polyline(legs, 3e-6, 5e-6, 160e9).xy)
    bending = 160e9 * 5e-6 * 3e-6**3 / 12.0
    printed = 3.0 * bending * (200e-6 - 150e-6) / (150e-6 * 200e-6**3)
    report.row("crab leg, (1.14) as printed over exact coupling", 1.0, printed / exact, "(1.14) is of a U fold")
    comb = mg.geometry.Comb(113.0, 5e-6, 1e-6, 50e-6, 0.1e-6)
    report.row("comb of Table 5.3: gradient [fF/µm]", 5.0, 1e9 * float(comb.gradient), "(3.5)")
    report.answer(
        "T3",
        claimed="10 % of thickness give 10 % of stiffness; (1.9) for squeezed films, (1.14) for crab legs; 5 fF/µm",
        obtained=f"{100 * thick:.1f} % by thickness, {100 * wide:.0f} % by 10 % of width; comb "
        f"{1e9 * float(comb.gradient):.2f} fF/µm",
        reading=f"(1.9) as printed is {terms[0] / film:.2f} of the series, {terms[1] / film:.2f} with 1 + τ²; (1.14) "
        f"{printed / exact:.2f} of a crab leg's coupling",
        verdict=PARTLY,
        why="Springs, combs and forces hold; (1.9) is misprinted, and (1.14) belongs to a U fold of nearly equal legs.",
    )


def circuit(report: Report) -> None:
    readout = mg.ChargeAmplifier.chi2010()
    offset, scale = np.asarray(readout.offset, float), np.asarray(readout.scale, float)
    for i, claimed in enumerate((15.0, 11.0)):
        report.row(f"Table 5.3: offset {'xy'[i]} [mV]", claimed, 1e3 * float(offset[i]), "mismatch and op-amp")
    report.row("  sensitivity [mV/µm]", 100.0, 1e-3 * abs(float(scale[0])))
    alone = 1e3 * offset - 1e3 * np.abs(scale) * np.array([0.1e-6, 0.085e-6])
    for i in (0, 1):
        report.row(f"  {'xy'[i]} by (3.10) as printed, the op-amp alone [mV]", "-", float(alone[i]))
    report.answer(
        "T4",
        claimed="Φx 15 mV, Φy 11 mV, about 100 mV/µm",
        obtained=f"{1e3 * offset[0]:.2f} and {1e3 * offset[1]:.2f} mV, {1e-3 * abs(scale[0]):.1f} mV/µm",
        reading=f"(3.10) as printed gives {alone[0]:.1f} and {alone[1]:.1f} mV",
        verdict=HOLDS,
        why="They are mismatch and op-amp together, (3.12) with ν = 1; (3.10) as printed leaves the mismatch out.",
    )


report = Report()
modes(report)
layout(report)
circuit(report)
report.finish()
