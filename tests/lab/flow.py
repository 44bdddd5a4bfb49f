"""Time integration of many rows side by side: Dormand and Prince of order 8, halted at switches of non-smooth laws."""

import numpy as np
from scipy.integrate import DOP853


STEPS_PER_PERIOD = 48
CHUNK = 2048  # rows that fit the cache
# How well a switch is placed in a step: an error δ changes the motion by δ where a force jumps, by δ² where it bends.
SHARP, SMOOTH = 1e-12, 1e-7
A, B, C = DOP853.A, DOP853.B, DOP853.C


def step(slope, t, state, h):
    """One step of length h (rows) from t (rows); `state` (parts, rows)."""
    slopes = np.empty((len(C), *state.shape))
    slopes[0] = slope(t, state)
    flat = slopes.reshape(len(C), -1)
    for i in range(1, len(C)):
        increment = (A[i, :i] @ flat[:i]).reshape(state.shape)
        slopes[i] = slope(t + C[i] * h, state + h * increment)
    return state + h * (B @ flat).reshape(state.shape)


def integrate(law, state, start, end, rows, period):
    """State (parts, rows) at `end` (rows) of rows that are in `state` at `start`, each under its own conditions."""
    steps = max(1, int(np.ceil(STEPS_PER_PERIOD * np.max(np.abs(end - start)) / period - 1e-6)))
    run = _stopping if law.switches else _plain
    out = np.empty_like(state)
    for first in range(0, state.shape[1], CHUNK):
        part = slice(first, first + CHUNK)
        out[:, part] = run(law, state[:, part], start[part], end[part], rows.take(part), steps)
    return out


def _plain(law, state, start, end, rows, steps):
    h = (end - start) / steps
    mode = np.empty((0, state.shape[1]))
    for i in range(steps):
        state = step(lambda t, s: law.slope(t, s, rows, mode), start + i * h, state, h)
    return state


def _stopping(law, state, start, end, rows, steps):
    """Every row has its own clock: it halts at the first switch inside a step, changes mode and goes on."""
    state, t = state.copy(), start.copy()
    full = (end - start) / steps
    state, mode = law.start(t, state, rows)
    idle = np.zeros(len(t), dtype=int)
    going = np.flatnonzero(np.abs(end - t) > 0)
    while going.size:
        own, clock = rows.take(going), t[going]
        h = np.minimum(full[going], end[going] - clock)
        new, h, hit = _to_first_switch(law, clock, state[:, going], h, own, mode[:, going], idle[going] < 4)
        last = h >= end[going] - clock - 1e-9 * full[going]
        t[going] = np.where(last, end[going], clock + h)
        idle[going] = np.where(h > 1e-9 * full[going], 0, idle[going] + 1)
        changed = np.flatnonzero(hit.any(axis=0))
        if changed.size:
            at = going[changed]
            new[:, changed], mode[:, at] = law.switch(
                t[at], new[:, changed], rows.take(at), mode[:, at], hit[:, changed]
            )
        state[:, going] = new
        going = going[t[going] < end[going]]
    return state


def _to_first_switch(law, t, state, h, rows, mode, watch):
    """A step, shortened in those rows where a margin turns negative; also which margins were met (switches, rows)."""
    new = step(lambda a, s: law.slope(a, s, rows, mode), t, state, h)
    margin = law.margin(t + h, new, rows, mode)
    hit = (margin < 0) & watch
    switch, row = np.nonzero(hit)
    if row.size == 0:
        return new, h, hit
    pair, own, m, clock, begin = np.arange(row.size), rows.take(row), mode[:, row], t[row], state[:, row]

    def trial(length):
        return step(lambda a, b: law.slope(a, b, own, m), clock, begin, length)

    def missing(length):
        return law.margin(clock + length, trial(length), own, m)[switch, pair]

    before, after = law.margin(clock, begin, own, m)[switch, pair], margin[switch, row]
    lengths = np.full(hit.shape, np.inf)
    lengths[switch, row] = _root(missing, before, after, h[row], SHARP if law.jumps else SMOOTH)
    h = np.minimum(h, lengths.min(axis=0))
    hit = lengths <= h
    met = np.flatnonzero(hit.any(axis=0))
    own, m, clock, begin = rows.take(met), mode[:, met], t[met], state[:, met]
    new[:, met] = trial(h[met])
    return new, h, hit


def _root(function, at_zero, at_end, end, tolerance):
    """Just beyond the change from plus to minus in [0, end]: false position (Illinois), now and then a bisection."""
    low, high = np.zeros_like(end), end.copy()
    f_low, f_high = np.maximum(at_zero, 0.0), at_end.copy()
    side, least = np.zeros_like(end), 0.4 * tolerance * end
    for turn in range(60):
        guess = 0.5 * (low + high) if turn % 6 == 5 else low + (high - low) * f_low / (f_low - f_high)
        guess = np.clip(guess, low + least, high - least)  # or one end of the bracket would stay where it is
        value = function(guess)
        plus = value >= 0
        f_high = np.where(plus, np.where(side == 1, 0.5 * f_high, f_high), value)
        f_low = np.where(plus, value, np.where(side == -1, 0.5 * f_low, f_low))
        low, high = np.where(plus, guess, low), np.where(plus, high, guess)
        side = np.where(plus, 1, -1)
        if np.all(high - low <= tolerance * end):
            break
    return high
