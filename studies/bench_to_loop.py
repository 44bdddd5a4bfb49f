"""An effect that nobody knew of, from the record of a loop to a loop that copes with it, by the command line alone.

A gyroscope runs in closed loop with a device that has more physics than its model. What follows is what its user does:
`memsgyro simulate --case` records the signals of two short runs from rest; `diagnose` names what is missing; `fit`
writes the device with it; a study whose `[device]` is that file runs `sweep`, which shows the rate error that the
effect causes, and lowers it: by `tune`, which lets the filter expect a disturbance, or, where the pick-off is curved,
by a filter that knows the curve. Beside it stand the sweep of the true device and that of the linear model, whose
filter is the same.
"""

import json
from pathlib import Path
from typing import Any, NamedTuple

from memsgyro_jax.base import runtime


runtime.configure()

from memsgyro_jax.app import cli  # noqa: E402


class Hidden(NamedTuple):
    """An effect on x: its strength, the amplitude of the tone that excites the record, further numbers, and whether the
    filter can know it.
    """

    strength: str
    drive: str = "4 m/s^2"
    further: str = ""
    known: bool = False


HIDDEN = {
    "cubic_stiffness": Hidden("3e12 N/m^3", drive="1 m/s^2"),
    "quadratic_damping": Hidden("2e-4 N*s^2/m^2"),
    "pickoff_nonlinearity": Hidden("1e5 1/m", known=True),
    "parasitic_mode": Hidden("1e-2", further="settings = { omega = 25132.7, quality = 100.0 }"),
}
EFFECT = """
[[effects]]
name = "{name}"
axis = "x"
strength = "{strength}"
{further}
"""
NOISE = 'noise_density = "0.447 uV/sqrt(Hz)"'
MADE = f"""
[readout]
kind = "displacement"
scale = "0.1 V/um"
offset = ["15 mV", "11 mV"]
{NOISE}
"""
FITTED = f"""
[device]
file = "device.toml"
[readout]
kind = "fitted"
{NOISE}
"""
# From rest, so that a model can be compared with every sample; close to the first mode, so that the motion grows.
RECORD = """
[observer]
kind = "ekf"
prior = {{ amplitude = "0.1 um", motion_error = 1 }}
[controller]
kind = "damping_compensation"
tones = [
  {{ frequency = "600 Hz", amplitude = "53.95 m/s^2" }},
  {{ frequency = "2893 Hz", amplitude = "{drive}", axis = "x" }},
]
[loop]
displacement = "0 m"
[scenario]
rate = "0 rad/s"
[sweep]
duration = "{duration:g} ms"
"""
# Dies differ in how fast they turn, so that bias and scale factor part; the filter may expect a disturbance of x and y.
LOOP = """
[observer]
kind = "ekf"
annealing = {{}}
knows_pickoff = {knows}
process_noise = {{ velocity = ["{disturbance} m^2/s^3", "1e-9 m^2/s^3"] }}
[scenario]
rate = "0 rad/s"
[spread]
parameters."scenario.rate.level" = {{ kind = "uniform", low = "-5 rad/s", high = "5 rad/s" }}
[sweep]
dies = {dies}
sample_rate = "{rate:g} kHz"
duration = "{run:g} ms"
[tune]
free = ["observer.noise_density", "observer.process_noise.motion.2", "observer.process_noise.motion.3"]
dies = 16
validation_dies = 16
evaluations = 15
"""


def memsgyro(*tokens: object) -> None:
    """The command line in this process; raises where its status is not 0."""
    try:
        cli.main([str(token) for token in tokens])
    except SystemExit as end:
        if end.code != 0:
            raise RuntimeError(f"memsgyro {' '.join(map(str, tokens))}: exit status {end.code}") from end


class Story:
    """The files and commands of one hidden effect in one folder."""

    def __init__(self, name: str, folder: Path, **sizes: float):
        self.name, self.folder = name, folder
        hidden = HIDDEN[name]
        sizes = {"duration": 20, "dies": 48, "rate": 100, "run": 100, **sizes}
        effect = EFFECT.format(name=name, **hidden._asdict())
        quiet, wary, aware = (
            LOOP.format(disturbance=size, knows=knows, **sizes)
            for size, knows in (("1e-9", "false"), ("1e-4", "false"), ("1e-9", "true"))
        )
        studies = {
            "record": effect + MADE + RECORD.format(**hidden._asdict(), **sizes),
            "true": effect + MADE + quiet, "linear": MADE + quiet, "fitted": FITTED + quiet,
            "wary": FITTED + wary, "aware": FITTED + aware,
        }  # fmt: skip
        folder.mkdir(parents=True, exist_ok=True)
        for study, text in studies.items():
            (folder / f"{study}.toml").write_text(text)

    def diagnosed(self) -> dict[str, Any]:
        """Two runs are recorded, one of them to judge by; what is missing from the model of the device?"""
        for seed, role in enumerate(("fit", "validation")):
            memsgyro("simulate", self.path("record.toml"), "--case", self.path("case"), "--record", role,
                     "--role", role, "--seed", seed)  # fmt: skip
        memsgyro("diagnose", self.path("case"), "--json", self.path("diagnosis.json"))
        return json.loads(self.path("diagnosis.json").read_text())

    def fitted(self) -> dict[str, Any]:
        """The device with the effect, as the two runs hold it, in `device.toml`."""
        memsgyro("fit", self.path("case"), "--add", self.name, "x", "--out", self.path("device.toml"),
                 "--json", self.path("fit.json"))  # fmt: skip
        return json.loads(self.path("fit.json").read_text())

    def swept(self, study: str) -> dict[str, Any]:
        """Bias, scale-factor error, error and NIS of a study."""
        memsgyro("sweep", self.path(f"{study}.toml"), "--out", self.path(f"{study}-sweep"), "--overwrite")
        return json.loads(self.path(f"{study}-sweep/summary.json").read_text())

    def tuned(self) -> dict[str, Any]:
        """What the filter should expect of the fitted device, found by gradient; swept on dies of its own."""
        memsgyro("tune", self.path("fitted.toml"), "--out", self.path("tuned"))
        study = self.path("tuned/tuned.toml")
        study.rename(self.path("tuned.toml"))
        return self.swept("tuned")

    def path(self, name: str) -> Path:
        """A file of this story."""
        return self.folder / name


def main() -> None:
    from _common import Report

    report = Report()
    names = ["quadratic_damping"] if report.quick else list(HIDDEN)
    report.row("hidden effects", len(HIDDEN), len(names), "quick: without the linear model" if report.quick else "")
    for name in names:
        story = Story(name, report.folder / name)
        found, after = story.diagnosed(), story.fitted()
        named = ", ".join(f"{effect['name']} {effect['axis']}".strip() for effect in found["effects"])
        report.row(f"{name}: diagnose", f"{name} x", named, found["verdict"])
        (strength, *_) = after["effects"]
        report.row(f"{name}: fit", HIDDEN[name].strength, strength["value"], f"± {strength['std']:.2g}")
        studies = ("true", "fitted") if report.quick else ("linear", "true", "fitted")
        sweeps = {study: story.swept(study) for study in studies}
        if HIDDEN[name].known:
            sweeps["filter that knows it"] = story.swept("aware")
        else:
            sweeps["tuned"] = story.tuned() if not report.quick else story.swept("wary")
        for study, figures in sweeps.items():
            tell(report, f"{name}: {study}", figures, sweeps["true"])
    report.finish()


def tell(report: Any, what: str, figures: dict[str, Any], true: dict[str, Any]) -> None:
    bias, wanted = figures["bias_dps"], true["bias_dps"]
    scale, error = figures["scale_factor_error"], figures["rate_error_dps"]["end"]["rms"]
    remark = f"scale factor {100 * scale['value']:.2g} ± {100 * scale['std']:.2g} %, rms {error:.3g} deg/s, "
    report.row(f"{what}, bias [deg/s]", wanted["value"], bias["value"],
               f"± {bias['std']:.2g}, {remark}NIS {figures['nis']:.3g} of 2")  # fmt: skip


if __name__ == "__main__":
    main()
