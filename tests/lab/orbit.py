"""Settled motion by shooting, and long records by multiple shooting: all blocks are integrated side by side."""

import numpy as np
from lab.flow import integrate


NUDGE = 1e-5  # relative to typical motion, for differences
CLOSE = 1e-11
WINDOW = 512


class NotSettled(RuntimeError):
    """Newton's method found no motion: the device is far from linear, or unstable."""


def flow_and_slope(law, state, start, end, rows, period):
    """End states (parts, rows), and their derivatives by the start state (rows, parts, parts)."""
    n, count = state.shape
    nudges = NUDGE * np.array(law.weights)
    many = np.concatenate([state[:, None], state[:, None] + np.diag(nudges)[:, :, None]], axis=1).reshape(n, -1)
    index = np.tile(np.arange(count), n + 1)
    ends = integrate(law, many, start[index], end[index], rows.take(index), period).reshape(n, n + 1, count)
    slope = (ends[:, 1:] - ends[:, :1]) / nudges[None, :, None]
    return ends[:, 0], slope.transpose(2, 0, 1)


def steady(plant, rows, start, end, shift=0.0, guess=None):
    """State at `start` of the motion that returns after `end` to where it was, plus `shift` (parts, rows)."""
    weights = np.array(plant.weights)[:, None]
    state = np.zeros((plant.size, len(rows))) if guess is None else guess.copy()
    if guess is None and (plant.terms or plant.rates or plant.switches):
        state[:4] = steady(plant.linear(), rows, start, end)
    shift = np.broadcast_to(shift, state.shape)
    open_rows, slope, last = np.arange(len(rows)), None, np.full(len(rows), np.inf)
    for _ in range(60):
        here = (plant, state[:, open_rows], start[open_rows], end[open_rows], rows.take(open_rows), plant.die.period)
        if slope is None:
            ends, slope = flow_and_slope(*here)
            fresh = True
        else:
            ends, fresh = integrate(*here), False
        miss = ends - state[:, open_rows] - shift[:, open_rows]
        update = np.linalg.solve(np.eye(plant.size) - slope, miss.T[:, :, None])[:, :, 0].T
        size = np.max(np.abs(update / weights), axis=0)
        if not fresh and np.any(size > 0.1 * last):
            slope = None
            last[:] = np.inf
            continue
        state[:, open_rows] += update
        left = size > CLOSE * np.max(np.abs(state[:, open_rows] / weights), axis=0)
        if not left.any():
            return state
        open_rows, slope, last = open_rows[left], slope[left], size[left]
    raise NotSettled(f"{open_rows.size} of {len(rows)} rows have no settled motion")


def march(plant, rows, times, first):
    """States (parts, rows + 1) at `times` (rows + 1) of a motion that starts at `first` (parts,)."""
    guess = np.zeros((plant.size, len(times)))
    guess[:, 0] = first
    if not (plant.terms or plant.rates or plant.switches):
        return _window(plant, rows, times, guess)
    guess[:4] = march(plant.linear(), rows, times, first[:4])
    states, a, width = guess.copy(), 0, WINDOW
    states[:, 0] = first
    while a < len(rows):
        b = min(a + width, len(rows))
        trial = guess[:, a : b + 1].copy()
        trial[:, 0] = states[:, a]
        try:
            states[:, a : b + 1] = _window(plant, rows.take(slice(a, b)), times[a : b + 1], trial)
            a = b
        except NotSettled:
            if width == 1:
                raise
            width //= 4
    return states


def _window(plant, rows, times, states):
    """Newton's method on all inner states at once; the first one is given."""
    weights = np.array(plant.weights)[:, None]
    slope, last = None, np.inf
    for turn in range(25):
        here = (plant, states[:, :-1], times[:-1], times[1:], rows, plant.die.period)
        if slope is None:
            ends, slope = flow_and_slope(*here)
        else:
            ends = integrate(*here)
        update = _propagate(slope, ends - states[:, 1:])
        size = np.max(np.abs(update / weights))
        largest = np.max(np.abs((states[:, 1:] + update) / weights))
        if not size < 1e3 * max(1.0, largest) or (turn and size > 2 * last):
            break
        states[:, 1:] += update
        if size <= CLOSE * largest:
            return states
        if size > 0.1 * last:
            slope = None
        last = size
    raise NotSettled("the record did not converge")


def _propagate(slopes, misses):
    """e_1 = m_1, e_{k+1} = J_k e_k + m_k."""
    out = np.empty_like(misses)
    carried = np.zeros(misses.shape[0])
    for k in range(misses.shape[1]):
        carried = slopes[k] @ carried + misses[:, k]
        out[:, k] = carried
    return out
