"""Settled motion by shooting, and long records by multiple shooting: all blocks are integrated side by side."""

import numpy as np
from lab.flow import integrate


NUDGE = 1e-6  # relative to the motion, for differences
CLOSE, FLOOR = 1e-11, 1e-9  # relative size of the last correction: good enough; good enough if it shrinks no more
STUCK = 1e-8  # relative miss of a settled motion that cannot be narrowed down
WINDOW = 512
TURNS = 16


class NotSettled(RuntimeError):
    """Newton's method found no motion: the device is far from linear, or unstable."""


def flow_and_slope(law, state, start, end, rows, period):
    """End states (parts, rows), and their derivatives by the start state (rows, parts, parts)."""
    n, count = state.shape
    weights = np.array(law.weights)
    motion = np.max(np.abs(state / weights[:, None]), axis=0)
    nudges = NUDGE * weights[:, None] * np.where(motion > 0, motion, 1.0)
    many = np.concatenate([state[:, None], state[:, None] + np.eye(n)[:, :, None] * nudges], axis=1).reshape(n, -1)
    index = np.tile(np.arange(count), n + 1)
    ends = integrate(law, many, start[index], end[index], rows.take(index), period).reshape(n, n + 1, count)
    slope = (ends[:, 1:] - ends[:, :1]) / nudges
    return ends[:, 0], slope.transpose(2, 0, 1)


def steady(plant, rows, start, end, shift=0.0, guess=None):
    """State at `start` of the motion that returns after `end` to where it was, plus `shift` (parts, rows).

    Where the linear device's motion is no good start, a device at rest is (friction holds it), or the row below (its
    frequency is near). A response with several settled motions needs its history: this is no tool for it.
    """
    linear = not (plant.terms or plant.rates or plant.switches)
    state = np.zeros((plant.size, len(rows)))
    if guess is not None:
        state[:] = guess
    elif not linear:
        state[:4] = steady(plant.linear(), rows, start, end)
    shift = np.broadcast_to(shift, state.shape)
    state, settled = _settle(plant, rows, start, end, state, shift)
    if not settled.all():
        again = np.flatnonzero(~settled)
        rest = np.zeros((plant.size, again.size))
        state[:, again], settled[again] = _settle(
            plant, rows.take(again), start[again], end[again], rest, shift[:, again]
        )
    for row in np.flatnonzero(~settled):
        if row and settled[row - 1]:
            here, below = slice(row, row + 1), state[:, row - 1 : row].copy()
            one = (plant, rows.take(here), start[here], end[here], below, shift[:, here])
            state[:, here], settled[here] = _settle(*one)
    if not settled.all():
        raise NotSettled(f"{np.sum(~settled)} of {len(rows)} rows have no settled motion")
    return state


def _settle(plant, rows, start, end, state, shift):
    """Newton's method with halved steps; the states, and which of them have settled."""
    weights = np.array(plant.weights)[:, None]
    best, least = state.copy(), np.full(len(rows), np.inf)
    left = np.arange(len(rows))
    for _ in range(20):
        now = state[:, left]
        with np.errstate(over="ignore", invalid="ignore"):  # a step may go astray: it is halved
            ends, slope = flow_and_slope(plant, now, start[left], end[left], rows.take(left), plant.die.period)
        miss = (ends - now - shift[:, left]) / weights
        error = np.max(np.abs(miss), axis=0)
        better = error < least[left]
        least[left] = np.where(better, error, least[left])
        # A mass that sticks may sit anywhere: such a direction is left alone.
        inverse = np.linalg.pinv(np.eye(plant.size) - np.nan_to_num(slope / weights * weights[:, 0]), rcond=1e-7)
        update = weights * np.einsum("rij,jr->ir", inverse, miss)
        state[:, left] = np.where(better, now + update, 0.5 * (now + best[:, left]))
        best[:, left] = np.where(better, now, best[:, left])
        size = np.max(np.abs(update / weights), axis=0)
        far = ~better | (size > CLOSE * np.max(np.abs(now / weights), axis=0))
        far &= least[left] > 1e-15 * np.max(np.abs(now / weights), axis=0)
        left = left[far]
        if left.size == 0:
            break
    # Where friction just lets go, the last correction shrinks slowly but moves nothing that could be measured.
    settled = np.ones(len(rows), dtype=bool)
    settled[left] = least[left] <= STUCK * np.max(np.abs(best[:, left] / weights), axis=0)
    state[:, left] = best[:, left]
    return state, settled


def march(plant, rows, times, first, linear_first=None):
    """States (parts, rows + 1) at `times` (rows + 1) of a motion that starts at `first` (parts,).

    The first guess is that the motion changes as the linear device's does, which starts at `linear_first` (4,).
    """
    guess = np.repeat(first[:, None], len(times), axis=1)
    if not (plant.terms or plant.rates or plant.switches):
        guess[:, 1:] = 0.0
        return _window(plant, rows, times, guess)
    linear_first = first[:4] if linear_first is None else linear_first
    guess[:4] += march(plant.linear(), rows, times, linear_first) - linear_first[:, None]
    states, a, width = guess.copy(), 0, WINDOW
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
    for turn in range(TURNS):
        here = (plant, states[:, :-1], times[:-1], times[1:], rows, plant.die.period)
        with np.errstate(over="ignore", invalid="ignore"):
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
        if size <= CLOSE * largest or (0.1 * last < size <= FLOOR * largest):
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
