"""A measurement case made from physics that the package never sees: `case.toml`, CSV files and the truth.

How the effects act together, where their laws leave it open:

- Drive: the amplifier's gain, `drive_nonlinearity`, `force_misalignment`. Feedthrough sees the commanded force.
- Pick-off: `pickoff_scale_error`, then both nonlinearities of the scaled displacement, times `scale`; crosstalk of the
  other displacement, feedthrough and offset are added; the converter clips. The delay holds back the motion alone.
- Rate: W (1 + `rate_scale_error`) + `rate_offset` + `rate_bias_drift`, constant in each block of a rate table (its
  value at the middle). W' is `numpy.gradient` of the rate column over its times, so a step keeps its impulse.
- `rate_bias_drift` and `damping_step` touch one named record. Drift: a_j sin(π (j − 1/2) t / T), T the end of the last
  block.
- `finite_sweep_rate`: every row is the slow motion at its frequency, rising; transients of the sweep's start are over.

Precision without noise is about 1e-10 of the motion. Exception: a peak that rises above the converter's range for less
than a 48th of a cycle may pass unclipped (1e-5 of the phasor).
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from lab.die import Die, Hidden
from lab.experiments import Bench, Record, perform
from lab.plant import Plant
from lab.protocol import Laboratory


@dataclass(frozen=True)
class MadeCase:
    """What was measured and what was true: `records[name].clean` is the read-out without noise."""

    folder: Path
    die: Die
    effects: Hidden
    protocol: Laboratory
    records: dict[str, Record]


def make_case(folder, die, effects=None, seed=0, protocol=None):
    """Carries out the protocol on a die with hidden effects and writes the case into `folder`.

    The seed decides excitation (raw forces) and noise, each experiment on its own: leaving one out changes no other.
    """
    effects = effects or Hidden()
    protocol = protocol or (Laboratory.small() if die.axes == 2 else Laboratory.resonator())
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    plant, records = Plant(die, effects), {}
    for experiment in protocol.experiments:
        rng = np.random.default_rng([seed, *experiment.name.encode()])
        record = perform(experiment, Bench(plant, protocol, rng))
        _write_csv(folder / f"{record.name}.csv", record, protocol, rng)
        records[record.name] = record
    (folder / "case.toml").write_text(_toml(folder.name, die, protocol, records))
    return MadeCase(folder, die, effects, protocol, records)


def _write_csv(path, record, protocol, rng):
    """Known columns as they are, read-outs with noise."""
    parts = {"I": record.clean.real, "Q": record.clean.imag} if np.iscomplexobj(record.clean) else {"": record.clean}
    columns = dict(record.columns)
    single = "u [V]" in columns
    for c in range(record.clean.shape[1]):
        name = "y" if single else f"V{'xy'[c]}"
        for part, clean in parts.items():
            time = record.columns.get("t [s]")
            noisy = clean[:, c] + record.noise * protocol.faults.noise(len(clean), time, rng)
            noisy = protocol.faults.spoiled(noisy, time, rng)
            columns[f"{name}_{part} [V]" if part else f"{name} [V]"] = noisy
    known, decimals = len(record.columns), _decimals(record.noise)
    lines = [",".join(columns)]
    for row in zip(*columns.values(), strict=True):
        cells = [f"{v:.{protocol.digits + 2}g}" for v in row[:known]]
        lines.append(",".join(cells + [f"{v:.{decimals}f}" if decimals else f"{v:.17g}" for v in row[known:]]))
    path.write_text("\n".join(lines) + "\n")


def _decimals(noise):
    """So many that rounding stays below a hundredth of the noise; none where there is no noise."""
    return int(np.ceil(-np.log10(noise))) + 1 if noise else 0


GYRO_DESIGN = """\
[design]
mass = { value = 1.8e-7, unit = "kg", tolerance = 0.10 }
kxx = { value = 64.0, unit = "N/m", tolerance = 0.10 }
kyy = { value = 72.0, unit = "N/m", tolerance = 0.10 }
kxy = { low = 0.0, high = 1.0, unit = "N/m" }
dxx = { value = 3.6e-6, unit = "N*s/m", tolerance = 0.20 }
dyy = { value = 4.5e-6, unit = "N*s/m", tolerance = 0.20 }
dxy = { low = 0.0, high = 5e-7, unit = "N*s/m" }

[readout]
scale = { value = 0.5, unit = "V/um" }
adc_range = { value = 2.5, unit = "V" }
"""

GYRO_CONVENTIONS = """
[environment]
temperature = { value = %s, unit = "degC" }
bias_voltage = { value = %s, unit = "V" }

[conventions]
lock_in = "V(t) = Re[(I + i Q) exp(i w t)] for a drive force F cos(w t)"
noise = "white, Gaussian, independent between channels and samples; levels from undriven records"
"""

RESONATOR_DESIGN = """\
[design]
resonance = { value = %.3g, unit = "Hz", tolerance = 0.20 }
quality_factor = { value = %.2g, unit = "1", tolerance = 0.50 }
static_gain = { value = %.2g, unit = "V/V", tolerance = 0.30 }

[readout]
scale = { value = 1.0, unit = "V/V" }

[conventions]
input = "u is band-limited between samples"
lock_in = "V(t) = Re[(I + i Q) exp(i w t)] for a drive u cos(w t)"
noise = "white, Gaussian, independent between samples"
"""


def _toml(name, die, protocol, records):
    device = "single_mass" if die.axes == 2 else "resonator"
    head = f'schema = "memsgyro-case/1"\nname = "{name}"\ndescription = "made by a simulated laboratory"\n'
    lines = [head + f'device = "{device}"\n']
    if die.axes == 2:
        lines.append(_gyro_design(die) + GYRO_CONVENTIONS % (protocol.temperature, protocol.bias))
    else:
        w0 = np.sqrt(die.kxx / die.mass)
        lines.append(RESONATOR_DESIGN % (w0 / 2 / np.pi, w0 * die.mass / die.dxx, 1 / die.kxx))
    for record in records.values():
        entry = {"name": record.name, "kind": record.kind, "file": f"{record.name}.csv", **record.settings}
        if record.role:
            entry["role"] = record.role
        if protocol.declare_noise and record.noise:
            entry["noise_std"] = (protocol.faults.declared * record.noise, "V")
        lines.append("[[experiment]]\n" + "".join(f"{k} = {_value(v)}\n" for k, v in entry.items()))
    return "\n".join(lines)


def _gyro_design(die):
    """The thesis' design for a die of its, else the die's own numbers to two digits."""
    design = Die()
    if all(abs(getattr(die, name) / getattr(design, name) - 1) <= 0.2 for name in ("mass", "kxx", "kyy")):
        return GYRO_DESIGN
    lines = [("mass", die.mass, "kg", 0.10), ("kxx", die.kxx, "N/m", 0.10), ("kyy", die.kyy, "N/m", 0.10)]
    lines += [("dxx", die.dxx, "N*s/m", 0.20), ("dyy", die.dyy, "N*s/m", 0.20)]
    text = "[design]\n" + "".join(
        f'{name} = {{ value = {value:.2g}, unit = "{unit}", tolerance = {part} }}\n'
        for name, value, unit, part in lines
    )
    for name, value, unit in (("kxy", die.kxy, "N/m"), ("dxy", die.dxy, "N*s/m")):
        text += f'{name} = {{ low = 0.0, high = {2 * value:.2g}, unit = "{unit}" }}\n'
    return text + GYRO_DESIGN[GYRO_DESIGN.index("\n[readout]") :]


def _value(value):
    if isinstance(value, tuple):
        return f'{{ value = {value[0]:.12g}, unit = "{value[1]}" }}'
    if isinstance(value, bool):
        return str(value).lower()
    return f'"{value}"' if isinstance(value, str) else str(value)
