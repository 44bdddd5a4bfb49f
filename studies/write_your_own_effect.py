"""What if the physics that is missing is in no catalogue? A tutorial: diagnose, write the effect, diagnose again.

The records are made here, by the package itself, with noise from a seed: the experiments of the demonstration case, on
a gyroscope whose proof mass touches elastic stops at the strongest drive. No effect of the catalogue is a stop. The
diagnosis says so and shows the missing force; a file of fifteen lines adds the stop; the same records then say "found".
`memsgyro diagnose CASE --effects stop.py --report page.html` does the same on the command line.

The quick form has the x axis alone, as a resonator, and one sweep of it: of one axis the catalogue has fewer effects.
"""

from dataclasses import replace
from importlib.resources import files
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from _common import Report

from memsgyro_jax.base import runtime


runtime.configure()

from memsgyro_jax.app.report.diagnosis_page import diagnosis_page  # noqa: E402
from memsgyro_jax.device.gyro import SingleMassGyro  # noqa: E402
from memsgyro_jax.device.resonator import Resonator  # noqa: E402
from memsgyro_jax.diagnosis.diagnose import diagnose  # noqa: E402
from memsgyro_jax.diagnosis.fit import fit_case  # noqa: E402
from memsgyro_jax.diagnosis.result import Diagnosis, validation_error  # noqa: E402
from memsgyro_jax.effects import Effect, load_effects  # noqa: E402
from memsgyro_jax.measurement.case import Case, load_case  # noqa: E402
from memsgyro_jax.measurement.readings import model_of  # noqa: E402


STOP = """\
import equinox as eqx
import jax.numpy as jnp
from jax import Array
import memsgyro_jax.effects as fx

class Stop(fx.ForceEffect):
    name, unit, law = "elastic_stop", "N/m²", "F = −s·(|q| − 1.6 µm)²·sign(q) beyond the gap"
    axis: int = eqx.field(static=True, default=0)
    strength: fx.Scalar = fx.strength()

    def force(self, now: fx.Moment) -> Array:
        q = now.displacement[self.axis]
        return self.along(now, -self.strength * jnp.maximum(jnp.abs(q) - 1.6e-6, 0.0) ** 2 * jnp.sign(q))
"""
STRENGTH = 1e4  # N/m²
DEMO = files("memsgyro_jax") / "demo"
GYRO = {"mass": 1.8e-7, "kxx": 65.1, "kyy": 70.9, "kxy": 0.4, "dxx": 3.7e-6, "dyy": 4.6e-6, "dxy": 1.1e-7}
ONE_AXIS = """\
schema = "memsgyro-case/1"
name = "one axis"
device = "resonator"

[design]
resonance = { value = 3.0, unit = "kHz", tolerance = 0.1 }
quality_factor = { value = 900, unit = "1", tolerance = 0.2 }
mass = { value = 1.8e-7, unit = "kg", tolerance = 0.1 }

[readout]
scale = { value = 0.5, unit = "V/um" }

[drive]
unit = "N"

[[experiment]]
name = "sweep_x"
kind = "frequency_sweep"
file = "sweep_x.csv"
settled = true
noise_std = { value = 63.2, unit = "uV" }
"""


def main() -> None:
    report = Report()
    file = report.folder / "stop.py"
    file.write_text(STOP, encoding="utf-8")
    stops = load_effects(file, axes=1 if report.quick else 2)
    case = recorded(stops[0], report, seed=7)
    without = diagnose(None, case, tell=say)
    picture = diagnosis_page(without).save(report.folder / "without.html")
    print(f"\nWith the catalogue alone: {without.sentence}\nThe missing force is drawn in {picture}.")
    print(f"The file {file.name} that mends it:\n\n{STOP}", flush=True)
    found = diagnose(None, case, effects=stops, tell=say)
    print(f"\nWith the file: {found.sentence}\n")
    claims(report, without, found, file)
    report.picture(errors(without, found), "error")
    report.finish()


def say(text: str) -> None:
    print("  ", text, flush=True)


def recorded(stop: Effect, report: Report, seed: int) -> Case:
    """The experiments of the demonstration on a gyroscope with a stop, predicted by the package, with noise."""
    plan, device = (one_axis(report.folder / "plan") if report.quick else load_case(DEMO)), SingleMassGyro(**GYRO)
    if report.quick:
        mass, stiffness, damping = (GYRO[name] for name in ("mass", "kxx", "dxx"))
        device = Resonator(np.sqrt(stiffness / mass), np.sqrt(stiffness * mass) / damping, 1.0 / stiffness)
    truth = model_of(plan, device, effects=(type(stop)(0, STRENGTH),))
    clean, rng = fit_case(plan, model=truth, held=True), np.random.default_rng(seed)
    records = (noisy(record, clean.predicted(i), rng) for i, record in enumerate(plan.records))
    return replace(plan, name="stop", records=tuple(records))


def one_axis(folder: Path) -> Case:
    """What the demonstration recorded of x in its first sweep."""
    folder.mkdir(exist_ok=True)
    (folder / "case.toml").write_text(ONE_AXIS)
    header, *rows = (DEMO / "sweep_x.csv").read_text().splitlines()
    rows = [",".join(row.split(",")[:4]) for row in (header.replace("F_x", "F"), *rows)]
    (folder / "sweep_x.csv").write_text("\n".join(rows) + "\n")
    return load_case(folder)


def noisy(record, clean: np.ndarray, rng):
    parts = rng.standard_normal((2, *clean.shape))
    if np.iscomplexobj(clean):
        return replace(record, phasors=clean + record.noise_std * (parts[0] + 1j * parts[1]))
    return replace(record, signals=clean + record.noise_std * parts[0])


def claims(report: Report, without: Diagnosis, found: Diagnosis, file) -> None:
    report.row("lines of the file", "at most 15", len(file.read_text(encoding="utf-8").splitlines()))
    report.row("verdict with the catalogue alone", "not found", without.verdict)
    report.row("verdict with the file", "found", found.verdict)
    report.row("effects", "elastic_stop x", ", ".join(a.label for a in found.accepted))
    for a in found.accepted:
        off = (a.estimate[0] - STRENGTH) / a.std[0]
        report.row(f"{a.label} [{a.unit}]", STRENGTH, a.estimate[0], f"± {a.std[0]:.2g}, off by {off:+.1f} of that")
    stages = [validation_error(fit) for fit in (without.base, without.final, found.final)]
    best = " and ".join(a.label for a in without.accepted) or "nothing of the catalogue"
    remark = f"base model {stages[0]:.4g}, with {best} {stages[1]:.4g}"
    report.row("never fitted: error / noise", 1.0, stages[2], remark)


def errors(without: Diagnosis, found: Diagnosis):
    """Error over noise of every record: base model, best of the catalogue, with one's own effect."""
    figure, ax = plt.subplots(figsize=(8.0, 3.4), layout="constrained")
    labels = [f"{e.name}\n{'never fitted' if e.role == 'validation' else 'fitted'}" for e in found.base.errors]
    place = np.arange(len(labels))
    shown = ((without.base, "base model"), (without.final, "best of the catalogue"), (found.final, "with the stop"))
    for number, (fit, name) in enumerate(shown):
        ax.bar(place + 0.27 * (number - 1), [e.rms for e in fit.errors], 0.27, label=name, log=True)
    ax.axhline(1.0, color="k", lw=1.0, ls="--", label="noise")
    ax.set_ylim(0.5, None)
    ax.set_xticks(place, labels, fontsize="small")
    ax.set_ylabel("error / noise")
    ax.legend(frameon=False)
    return figure


if __name__ == "__main__":
    main()
