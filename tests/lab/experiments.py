"""Each kind of experiment, carried out on a plant: the columns of its file and what `case.toml` says of it."""

from dataclasses import dataclass, replace
from functools import singledispatch

import numpy as np
from lab.instrument import block_phasors, cycle_phasors, samples
from lab.orbit import march, steady
from lab.protocol import Multisine, RateTable, Raw, RingDown, Sweep
from lab.rows import rows


DEGREE = np.pi / 180


@dataclass(frozen=True)
class Record:
    """One experiment: known columns {header: values}, read-out without noise (n, axes), complex for a lock-in."""

    name: str
    columns: dict
    clean: np.ndarray
    settings: dict
    noise: float
    kind: str
    role: str


@dataclass(frozen=True)
class Bench:
    """A plant on the bench of a laboratory, with random numbers for the excitation."""

    plant: object
    lab: object
    rng: np.random.Generator

    def rows(self, count, name, **conditions):
        """Conditions of rows of the named record."""
        h, die = self.plant.hidden, self.plant.die
        if h.damping_step and name == h.damping_step_record:
            conditions["step_time"] = np.full(count, h.damping_step_time)
        return rows(die, h, count, **conditions)

    def unit(self, letter):
        """Name, unit text and SI factor of the force column of an axis."""
        return (f"F_{letter} [nN]", 1e-9) if self.plant.die.axes == 2 else (f"F_{letter} [V]", 1.0)

    def resonance(self, axis):
        """To the digits of a finder's display [Hz]."""
        return round(float(self.plant.die.resonances()[axis]), self.lab.finder)


@singledispatch
def perform(experiment, bench):
    """The record of an experiment."""
    raise TypeError(f"nobody knows how to do {experiment}")


def printed(values, digits):
    """Numbers as they read back from a file with so many digits: what is simulated is what the file says."""
    return np.array([float(f"{v:.{digits}g}") for v in np.ravel(values)]).reshape(np.shape(values))


def swing(axis, force, count):
    """Drive amplitude (2, rows)."""
    out = np.zeros((2, count))
    out[axis] = force
    return out


# ---- frequency sweep


@perform.register
def _(experiment: Sweep, bench):
    lab = bench.lab
    frequency = printed(_grid(experiment, bench), lab.digits)
    f = np.tile(frequency, len(experiment.values))
    value = np.repeat(experiment.values, len(frequency))
    letter = "xy"[experiment.axis]
    drive_column, unit = bench.unit(letter)
    header, factor = {
        "drive": (drive_column, unit), "bias": ("V_bias [V]", 1.0),
        "temperature": ("T [degC]", 1.0), "rate": ("rate [deg/s]", DEGREE),
    }[experiment.condition]  # fmt: skip
    column = printed(value / factor, lab.digits)
    known = column * factor
    conditions = {
        "drive": {}, "bias": {"bias": known**2 - lab.bias**2, "reference": lab.bias},
        "temperature": {"temperature": known - lab.temperature}, "rate": {"rate": known},
    }[experiment.condition]  # fmt: skip
    force = known if experiment.condition == "drive" else experiment.force
    faults = lab.faults
    conditions["pull"] = faults.pulled(len(f), bench.rng)
    given, shown = _transduced(bench.plant.hidden, known / lab.bias if experiment.condition == "bias" else 1.0)
    settled = shown * _sweep(bench, experiment, given * faults.force(force), 2 * np.pi * f, conditions)
    clean = faults.lock_in(settled, experiment.name, force, 2 * np.pi * f)
    settings = {"drive_axis": letter} if bench.plant.die.axes == 2 else {}
    if experiment.condition != "drive":
        settings["drive_force"] = (experiment.force / unit, drive_column[5:-1])
    settings |= {"settled": experiment.settled, "note": f"{header.split()[0]} is stepped"}
    columns = {"t [s]": faults.dwell * np.arange(len(f))} if faults.dwell else {}
    return _record(bench, experiment, "frequency_sweep", columns | {header: column, "f [Hz]": f}, clean, settings)


def _transduced(hidden, ratio):
    """What drive electrodes give and pick-off electrodes show, relative, where the bias is so many times its usual."""
    return np.power(ratio, hidden.bias_transduction_drive), np.reshape(ratio**hidden.bias_transduction_pickoff, (-1, 1))


def _grid(experiment, bench):
    """Frequencies [Hz] around the resonances, ascending, each once."""
    d, n = experiment.dense, experiment.points
    if np.isfinite(d):
        away = d * np.tan(np.linspace(-1, 1, n) * np.arctan(experiment.span / d))
    else:
        away = np.linspace(-experiment.span, experiment.span, n)
    around = range(bench.plant.die.axes) if experiment.both else (experiment.axis,)
    bands = [bench.resonance(c) + experiment.shift + away for c in around]
    if len(bands) == 2:  # bands may overlap on a die with a small split
        middle = np.mean([bench.resonance(0), bench.resonance(1)])
        bands = [bands[0][bands[0] < middle], bands[1][bands[1] >= middle]]
    return np.concatenate(bands)


def _sweep(bench, experiment, force, w, conditions):
    plant = bench.plant
    chirp = plant.hidden.finite_sweep_rate
    conditions = {k: np.broadcast_to(v, w.shape) for k, v in conditions.items()}
    drive = {"swing": swing(experiment.axis, force, len(w)), "frequency": w, "chirp": np.full(len(w), chirp)}
    own = bench.rows(len(w), experiment.name, **conditions, **drive)
    start, end = _cycle(w, chirp)
    states = _drifting(plant, own, chirp) if chirp else steady(plant, own, start, end)
    return cycle_phasors(plant, states, start, end, own)


def _cycle(w, chirp):
    """Times of phases -π and π of a drive whose frequency is w at time zero."""
    return -2 * np.pi / (w + np.sqrt(w**2 - 2 * np.pi * chirp)), 2 * np.pi / (w + np.sqrt(w**2 + 2 * np.pi * chirp))


STENCIL = np.arange(-4, 5)


def _drifting(plant, own, chirp):
    """States at phase -π of the motion that follows a moving frequency.

    After a cycle the state is not where it was but where the next cycle's motion starts, at a frequency higher by one
    cycle's worth of sweep. That difference comes from the same motion at neighbouring frequencies, by a polynomial
    through a stencil; repeating it takes in ever higher derivatives. A sweep that is fast beside the square of the
    bandwidth has no such slow motion.
    """
    die, n = plant.die, len(STENCIL)
    spacing = 0.1 * die.dxx / die.mass
    centre = np.tile(np.arange(len(own)), n)
    many = own.take(centre)
    many = replace(many, frequency=many.frequency + spacing * np.repeat(STENCIL, len(own)))
    start, end = _cycle(many.frequency, chirp)
    states = steady(plant, many, start, end)
    for _ in range(n):
        shape = (plant.size, n, len(own))
        coefficients = np.polynomial.polynomial.polyfit(
            STENCIL, states.reshape(shape).transpose(1, 0, 2).reshape(n, -1), n - 1
        ).reshape(n, plant.size, len(own))
        first = (many.frequency + chirp * start - own.frequency[centre]) / spacing
        last = (many.frequency + chirp * end - own.frequency[centre]) / spacing
        series = coefficients[:, :, centre]
        value = np.polynomial.polynomial.polyval
        shift = value(last, series, tensor=False) - value(first, series, tensor=False)
        states = steady(plant, many, start, end, shift, guess=states)
    return states.reshape(plant.size, n, len(own))[:, n // 2]


# ---- ring-down


@perform.register
def _(experiment: RingDown, bench):
    plant, digits = bench.plant, bench.lab.digits
    f = bench.resonance(experiment.axis)
    cycles = int(np.floor(experiment.duration * f))
    ticks = np.arange(experiment.samples) * 1.0
    if experiment.jitter:
        ticks = np.delete(ticks, np.s_[len(ticks) // 2 : 6 * len(ticks) // 10])
        ticks[1:] += experiment.jitter * bench.rng.uniform(-0.5, 0.5, len(ticks) - 1)
    t = printed(ticks * experiment.interval, digits)
    driven = -np.arange(cycles, 0, -1) / f
    times = np.concatenate([driven, t])
    count = len(times) - 1
    force = swing(experiment.axis, experiment.force, count + 1)
    force[:, cycles:] = 0.0
    own = bench.rows(count + 1, experiment.name, swing=force, frequency=np.full(count + 1, 2 * np.pi * f))
    states = march(plant, own.take(slice(0, count)), times, np.zeros(plant.size))
    clean = samples(plant, states, times, own, np.arange(cycles, count + 1))
    letter = "xy"[experiment.axis]
    unit, factor = ("nN", 1e-9) if plant.die.axes == 2 else ("V", 1.0)
    settings = {"drive_axis": letter} if plant.die.axes == 2 else {}
    settings |= {
        "drive_force": (experiment.force / factor, unit), "drive_frequency": (f, "Hz"),
        "drive_duration": (experiment.duration, "s"),
        "note": "starts at rest, driven with F cos(w t) for a whole number of cycles nearest below the duration, "
        "force removed at t = 0",
    } | ({"uneven": True} if experiment.jitter else {})  # fmt: skip
    return _record(bench, experiment, "ring_down", {"t [s]": t}, clean, settings)


# ---- rate table


@perform.register
def _(experiment: RateTable, bench):
    plant, h, digits = bench.plant, bench.plant.hidden, bench.lab.digits
    f = bench.resonance(experiment.axis)
    times = np.arange(-1, experiment.blocks + 1) * (experiment.cycles / f)  # a settled block comes first
    middle = 0.5 * (times[1:-1] + times[2:])
    t = printed(middle, digits)
    columns = {"t [s]": t}
    rate = np.zeros(experiment.blocks)
    if experiment.profile is not None:
        columns["rate [deg/s]"] = printed(experiment.profile(middle), digits)
        rate = columns["rate [deg/s]"] * DEGREE
    turn = np.gradient(rate, t)
    if h.rate_bias_drift and experiment.name == h.rate_bias_drift_record:
        order = np.arange(len(h.rate_bias_drift)) + 0.5
        drift = np.sin(np.pi * t[:, None] * order / times[-1]) @ np.array(h.rate_bias_drift)
        rate = rate + drift / (1 + h.rate_scale_error)  # the table's scale is not the drift's
    conditions = {
        "rate": np.append(rate[0], rate), "turn": np.append(0.0, turn), "calibrated": experiment.calibrated,
        "swing": swing(experiment.axis, experiment.force, len(rate) + 1),
        "frequency": np.full(len(rate) + 1, 2 * np.pi * f),
    }  # fmt: skip
    own = bench.rows(len(rate) + 1, experiment.name, **conditions)
    clean = _rate_table(plant, own, times, experiment.cycles)
    settings = {
        "drive_axis": "xy"[experiment.axis], "drive_force": (experiment.force / 1e-9, "nN"),
        "drive_frequency": (f, "Hz"), "lock_in_cycles": experiment.cycles,
    }  # fmt: skip
    if experiment.calibrated:
        settings["rate_reference"] = "calibrated"
    settings["note"] = (
        "open loop, settled before t = 0, boxcar lock-in over lock_in_cycles drive cycles, "
        "time and rate at the middle of each block"
        if experiment.profile
        else "no rate column: the table stands still"
    )
    return _record(bench, experiment, "rate_table", columns, clean, settings)


def _rate_table(plant, own, times, cycles):
    """Phasors of all blocks but the first, which is settled."""
    first, start = own.take(slice(0, 1)), times[:1]
    end = start + (times[1] - times[0]) / cycles
    settled = steady(plant, first, start, end)
    if np.ptp(own.rate) == 0 and np.all(np.isinf(own.step_time)):
        return np.repeat(cycle_phasors(plant, settled, start, end, first), len(own) - 1, axis=0)
    linear = steady(plant.linear(), first, start, end)
    states = march(plant, own, times, settled[:, 0], linear[:, 0])
    return block_phasors(plant, states, times, own, cycles)


# ---- time records


@perform.register
def _(experiment: Raw, bench):
    plant, n, dt = bench.plant, experiment.samples, experiment.interval
    t = printed(np.arange(n) * dt, bench.lab.digits)
    bins = np.arange(np.ceil(experiment.band[0] * n * dt), np.floor(experiment.band[1] * n * dt) + 1)
    u = np.empty((2, n))
    for c in (0, 1):
        own = bins[c::2]
        phases = bench.rng.uniform(0, 2 * np.pi, len(own))
        wave = np.cos(2 * np.pi * np.outer(np.arange(n) / n, own) + phases).sum(axis=1)
        u[c] = printed(experiment.force / 1e-9 * np.sqrt(2 / len(own)) * wave, bench.lab.digits)
    own = bench.rows(n, experiment.name, held=1e-9 * u[None])
    states = march(plant, own.take(slice(0, n - 1)), t, np.zeros(plant.size))
    clean = samples(plant, states, t, own, np.arange(n))
    columns = {"t [s]": t, "u_x [nN]": u[0], "u_y [nN]": u[1]}
    note = "forces in columns u_x, u_y are held from each sample to the next; rate 0"
    settings = {"hold": "zero_order", "start": "rest", "note": note}
    return _record(bench, experiment, "time_record", columns, clean, settings)


@perform.register
def _(experiment: Multisine, bench):
    plant, n, dt = bench.plant, experiment.samples, experiment.interval
    bins = np.arange(np.ceil(experiment.band[0] * n * dt), np.floor(experiment.band[1] * n * dt) + 1)
    spectrum = np.zeros(n // 2 + 1, dtype=complex)
    spectrum[bins.astype(int)] = np.exp(2j * np.pi * bench.rng.uniform(size=len(bins)))
    wave = np.fft.irfft(spectrum, n)
    level = experiment.level / np.sqrt(np.mean(wave**2))
    u = printed(level * wave, bench.lab.digits)
    before = min(256, n // 2)  # the periodic input has been on for this long; the record's start is anybody's guess
    times = np.arange(-before, n) * dt
    held = np.zeros((DEGREE_OF_HOLD + 1, 2, before + n))
    series = _between_samples(u)
    held[:, 0] = series[:, np.arange(-before, n) % n]
    own = bench.rows(before + n, experiment.name, held=held, origin=times, span=np.full(before + n, dt))
    states = march(plant, own.take(slice(0, before + n - 1)), times, np.zeros(plant.size))
    clean = samples(plant, states, times, own, np.arange(before, before + n))
    columns = {"t [s]": printed(times[before:], bench.lab.digits + 2), "u [V]": u}
    settings = {"hold": "band_limited", "start": "unknown", "note": "the input is periodic over the record"}
    return _record(bench, experiment, "time_record", columns, clean, settings)


DEGREE_OF_HOLD = 16


def _between_samples(u):
    """Chebyshev series (terms, samples) of the periodic band-limited input over each sample interval."""
    nodes = np.cos(np.pi * (np.arange(DEGREE_OF_HOLD + 1) + 0.5) / (DEGREE_OF_HOLD + 1))
    frequency = np.fft.rfftfreq(len(u))
    shifted = [np.fft.irfft(np.fft.rfft(u) * np.exp(2j * np.pi * frequency * 0.5 * (x + 1)), len(u)) for x in nodes]
    return np.polynomial.chebyshev.chebfit(nodes, np.array(shifted), DEGREE_OF_HOLD)


def _record(bench, experiment, kind, columns, clean, settings):
    clean = clean[:, : bench.plant.die.axes]
    return Record(experiment.name, columns, clean, settings, experiment.noise * bench.lab.noise, kind, experiment.role)
