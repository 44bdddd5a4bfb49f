"""What is wrong with the instruments of a laboratory, not with its dies: levels, references, clocks, digits."""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Faults:
    """Every number zero (or one, or none) is an instrument as declared. Sweeps alone see what a lock-in does.

    Args:
        levels: relative error of each drive level of a sweep, in the order of the levels.
        phase: by which the lock-in's reference is turned [rad].
        gains: relative error of the gain by record name.
        background, feedthrough: phasor that is always there [V], and in proportion to the drive [V per unit of drive].
        capacitance: likewise, and to its frequency besides [V s per unit of drive].
        pull: relative change of every frequency from the first to the last row, growing evenly.
        gain_drift, phase_drift: likewise of the gain, and of the reference [rad].
        dwell: time from row to row [s]; a clock is written where it is not zero.
        filter_time, filter_order: of the lock-in's low-pass [s], a cascade of first-order stages.
        jitter: standard deviation of the drive frequency, relative, from row to row.
        wander: relative amplitude of a slow beat of the resonances over the rows of a sweep, one and a half turns.
        phase_jump: by which the reference turns within a sweep's rows, after two fifths of them [rad].
        lost_row: whether a row is lost there: from then on each reads what belongs to the next.
        outliers: share of the rows that read anything up to the largest reading.
        mains: amplitude [V] of 50 Hz in waveforms, with a third of it at 150 Hz.
        quantum: step of the converter [V].
        corner: frequency [Hz] below which the noise is 1/f: its spectrum is white times 1 + corner/f.
        row_time: from row to row of a sweep, where no clock is written [s].
        declared: factor by which the noise that the case declares differs from the true one.
    """

    levels: tuple = ()
    phase: float = 0.0
    gains: tuple = ()
    background: complex = 0.0
    feedthrough: complex = 0.0
    capacitance: complex = 0.0
    pull: float = 0.0
    gain_drift: float = 0.0
    phase_drift: float = 0.0
    dwell: float = 0.0
    filter_time: float = 0.0
    filter_order: int = 1
    jitter: float = 0.0
    wander: float = 0.0
    phase_jump: float = 0.0
    lost_row: bool = False
    outliers: float = 0.0
    mains: float = 0.0
    quantum: float = 0.0
    declared: float = 1.0
    corner: float = 0.0
    row_time: float = 0.05

    def force(self, declared):
        """The true drive of each row."""
        if not self.levels:
            return declared
        known = np.unique(declared)
        return declared * (1 + np.asarray(self.levels)[np.searchsorted(known, declared) % len(self.levels)])

    def pulled(self, count, rng):
        """Relative change of the resonances against the drive frequency, row by row."""
        shift = self.pull * (np.linspace(0, 1, count) - 0.5)
        shift = shift + self.wander * np.sin(3 * np.pi * np.linspace(0, 1, count))
        return shift - self.jitter * rng.standard_normal(count) if self.jitter else shift

    def lock_in(self, clean, name, force, omega):
        """What the lock-in shows of settled phasors (rows, axes)."""
        along = np.linspace(-0.5, 0.5, len(clean))[:, None]
        gain = (1 + dict(self.gains).get(name, 0.0) + self.gain_drift * along) * np.exp(
            1j * (self.phase + self.phase_drift * along)
        )
        late = np.arange(len(clean)) >= 2 * len(clean) // 5
        gain = gain * np.exp(1j * self.phase_jump * late[:, None])
        if self.lost_row:
            clean = np.where(late[:, None], np.append(clean[1:], clean[-1:], axis=0), clean)
        leak = (self.feedthrough + self.capacitance * omega) * np.broadcast_to(force, len(clean))
        seen = gain * clean + self.background + leak[:, None]
        return self._filtered(seen) if self.filter_time else seen

    def _filtered(self, settled):
        """Behind the low-pass: each row begins where the last ended. A stage has τ·y' = x − y."""
        at, out = np.repeat(settled[:1], self.filter_order, axis=0), np.empty_like(settled)
        steps = 200
        share = -np.expm1(-self.dwell / steps / self.filter_time)
        for row, value in enumerate(settled):
            if self.filter_order == 1:
                at = value + (at - value) * np.exp(-self.dwell / self.filter_time)
            else:
                for _ in range(steps):
                    entering = value
                    for stage in range(self.filter_order):
                        at[stage] = at[stage] + share * (entering - at[stage])
                        entering = at[stage]
            out[row] = at[-1]
        return out

    def noise(self, count, time, rng):
        """Noise of rows (n,) whose white part is one."""
        white = rng.standard_normal(count)
        if not self.corner:
            return white
        step = self.row_time if time is None else (time[-1] - time[0]) / (count - 1)
        long = 8 * count  # a stretch of a longer record, which does not end where it begins
        f = np.fft.rfftfreq(long, step)
        size = np.sqrt(1 + self.corner / np.where(f > 0, f, np.inf)) * (f > 0)
        return np.fft.irfft(size * np.fft.rfft(rng.standard_normal(long)), long)[:count]

    def spoiled(self, values, time, rng):
        """Real readings (n,) with mains, wrong rows and the steps of the converter."""
        if self.mains and time is not None:
            turn = 2 * np.pi * 50.0 * time
            values = values + self.mains * (np.cos(turn + 0.3) + np.cos(3 * turn + 1.1) / 3)
        if self.outliers:
            wrong = rng.uniform(size=len(values)) < self.outliers
            values = np.where(wrong, np.max(np.abs(values)) * rng.uniform(-1, 1, len(values)), values)
        return self.quantum * np.round(values / self.quantum) if self.quantum else values
