"""What the instruments make of the motion: boxcar lock-in amplifiers, delayed samplers, a converter that clips."""

import numpy as np
from lab.flow import integrate


class LockIn:
    """The law of a plant with four more parts of the state: the running integrals of V cos φ and V sin φ.

    The read-out lags: at time t of the motion the instrument is at t + delay, with the drive and reference of then.
    """

    def __init__(self, plant):
        self.plant, self.delay, limit = plant, plant.hidden.readout_delay, plant.limit()
        self.jumps = plant.jumps
        self.own = len(plant.switches)
        self.clips = [(c, side, limit) for c in (0, 1) for side in (1, -1)] if np.isfinite(limit) else []
        self.switches = [*plant.switches, *self.clips]

    def _voltage(self, t, state, rows):
        return self.plant.voltage(state, rows.command(t + self.delay))

    def slope(self, t, state, rows, mode):
        n, instrument = self.plant.size, t + self.delay
        out = np.empty_like(state)
        out[:n] = self.plant.slope(t, state[:n], rows, mode[: self.own])
        v = self._voltage(t, state[:n], rows)
        for j, (c, side, limit) in enumerate(self.clips):
            v[c] = np.where(mode[self.own + j] > 0, side * limit, v[c])
        weight, phase = v * (rows.frequency + rows.chirp * instrument), rows.phase(instrument)
        out[n : n + 2], out[n + 2 :] = weight * np.cos(phase), weight * np.sin(phase)
        return out

    def margin(self, t, state, rows, mode):
        inner = self.plant.margin(t, state[: self.plant.size], rows, mode[: self.own]) if self.own else []
        return np.array([*inner, *(mode[self.own :] * self._excess(t, state, rows))])

    def _excess(self, t, state, rows):
        v = self._voltage(t, state[: self.plant.size], rows)
        return np.array([side * v[c] - limit for c, side, limit in self.clips]).reshape(-1, len(t))

    def start(self, t, state, rows):
        n, inner = self.plant.size, np.empty((0, len(t)))
        if self.own:
            state = state.copy()
            state[:n], inner = self.plant.start(t, state[:n], rows)
        return state, np.concatenate([inner, np.where(self._excess(t, state, rows) < 0, -1.0, 1.0)])

    def switch(self, t, state, rows, mode, hit):
        n, after = self.plant.size, np.where(hit, -mode, mode)
        if self.own:
            state = state.copy()
            state[:n], after[: self.own] = self.plant.switch(t, state[:n], rows, mode[: self.own], hit[: self.own])
        return state, after


def cycle_phasors(plant, states, start, end, rows):
    """Phasors (rows, 2) over one cycle of settled motion."""
    law = LockIn(plant)
    begin = np.concatenate([states, np.zeros((4, states.shape[1]))])
    return _phasors(integrate(law, begin, start, end, rows, plant.die.period)[plant.size :], 1)


def block_phasors(plant, states, times, rows, cycles):
    """Phasors (rows - 1, 2) of blocks of whole cycles; the first row is the block before the record."""
    law, n, period = LockIn(plant), plant.size, plant.die.period
    begin = np.concatenate([states[:, :-1], np.zeros((4, len(rows)))])
    middle = integrate(law, begin, times[:-1], times[1:] - law.delay, rows, period)
    head, state = middle[n:], middle.copy()
    state[n:] = 0
    tail = 0.0 * head
    if law.delay:
        tail = integrate(law, state, times[1:] - law.delay, times[1:], rows, period)[n:]
    return _phasors(head[:, 1:] + tail[:, :-1], cycles)


def _phasors(integrals, cycles):
    return ((integrals[:2] - 1j * integrals[2:]) / (np.pi * cycles)).T


def samples(plant, states, times, rows, at):
    """Signals (samples, 2) at the nodes `at` (indices of `times`), as the converter gives them."""
    moment = times[at] - plant.hidden.readout_delay
    command = rows.take(at).command(times[at])
    if not plant.hidden.readout_delay:
        seen = states[:, at]
    else:
        block = np.maximum(np.searchsorted(times, moment, side="right") - 1, 0)
        start = times[block]
        seen = integrate(plant, states[:, block], start, np.maximum(moment, start), rows.take(block), plant.die.period)
    limit = plant.limit()
    return np.clip(plant.voltage(seen, command), -limit, limit).T
