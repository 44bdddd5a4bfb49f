"""The device of one axis behind what an instrument makes of its phasors: a gain that turns, a background, a delay of
many periods; or behind amplitudes alone.
"""

from typing import NamedTuple

import numpy as np

from memsgyro_jax.device.normalised import NormalisedDevice


ROUNDS = 12
_BENT, _BENDS, _FINER = 1.5, 301, 41  # how far a resonance may bend over, in widths of the band; steps that are tried
_VANISHES = 1e-12  # of the largest operator
_NARROW = 1e-3  # of the distance from row to row: a resonance within it is one row's own
_BETTER = 0.5  # of the squared error of the plain resonance that one with more numbers must come to
_LOUD = 4.0  # times the squared noise, beyond which a delay is looked for
_LATE = 0.1  # of the squared error, that a delay must leave
_TURNED = 1.0  # rad over the band: what turns less, a complex parabola holds
_REACH, _STEP = 5.0, 0.4  # rad over the band about a first guess, and from one trial to the next


class Seen(NamedTuple):
    """A device (stiffness, damping, mobility per mass), `None` for what is none, the squared misfit that it leaves, the
    angle [rad] by which what is read is turned at its resonance, and how late it comes [s] beside what is read at the
    `middle` of the frequencies [rad/s].
    """

    device: tuple[np.ndarray, np.ndarray, float] | None
    misfit: float
    angle: float
    delay: float = 0.0
    middle: float = 0.0


def behind_an_instrument(plain, omega, motion, force, weight):
    """The device where gain and background are complex, as instruments have them, and its resonance bends over, or all
    is read late, where each explains much more.

    (K − ω² + iωD + c|X|²)·X = n(ω)·F with a complex parabola n: a gain that turns the phase, and a background in
    proportion to the drive, are of this form.
    """
    found = _with_gain(omega, motion, force, weight, plain, bends=False)
    bent = _with_gain(omega, motion, force, weight, plain, bends=True)
    if bent.device is not None and (found.device is None or bent.misfit < _BETTER * found.misfit):
        found = bent
    late = lateness(omega, motion, force, weight)
    found = found if late is None else late
    alone = plain[0][0] - omega**2 + 1j * omega * plain[1][0]
    unturned = np.sum(np.abs((motion - plain[2] * force / alone) * weight) ** 2)
    good = plain[0][0] > 0.0 and plain[1][0] > 0.0
    return plain if found.device is None or (found.misfit > _BETTER * unturned and good) else found.device


def lateness(omega, motion, force, weight) -> Seen | None:
    """The device behind phasors (n,) that come late by many periods, by a delay that turns them by more than a complex
    parabola holds; `None` where they do not, or what is left is not far less than without, or was noise before.

    The phase from row to row tells the delay to what a resonance turns, and trials about it the rest.
    """
    span, driven = np.ptp(omega), np.abs(force) > 0
    if not (span and driven.all()):
        return None
    plain = (np.array([np.median(omega) ** 2]), np.array([span]), 1.0)
    given = omega, force, weight, plain
    best = _late_by(0.0, motion, *given)
    before = best.misfit
    if before < _LOUD * 2 * len(omega):
        return None
    ratio, step = motion / force, np.diff(omega)
    near = (step != 0) & (np.abs(step) <= 2 * np.median(np.abs(step)))
    pairs = ratio[1:] * np.conj(ratio[:-1])
    pairs = np.where(step > 0, pairs, np.conj(pairs))[near]
    first = -np.angle(np.sum(pairs)) / np.median(np.abs(step[near])) if near.any() else 0.0
    for reach, part in ((_REACH, _STEP), (_STEP, _STEP / 10)):
        for delay in first + np.arange(-reach, reach + part / 2, part) / span:
            one = _late_by(float(delay), motion, *given)
            best = one if one.device is not None and one.misfit < best.misfit else best
        first = best.delay
    clear = best.misfit < _LATE * before and abs(best.delay) * span > _TURNED
    return best if clear and best.device is not None else None


def _late_by(delay: float, motion, omega, force, weight, plain) -> Seen:
    """What is seen of phasors that come so late [s]."""
    middle = float(np.median(omega))
    found = _with_gain(omega, motion * np.exp(1j * (omega - middle) * delay), force, weight, plain, bends=False)
    return found._replace(delay=delay, middle=middle)


def _with_gain(omega, motion, force, weight, plain, *, bends: bool) -> Seen:
    """The device with a gain that turns."""
    centre, span = omega.mean(), np.ptp(omega) or 1.0
    place, near, target = (omega - centre) / span, omega**2 - centre**2, (omega**2 - centre**2) * motion
    powers = -force[:, None] * place[:, None] ** np.arange(3)
    columns = np.concatenate([motion[:, None], 1j * omega[:, None] * motion[:, None], powers, 1j * powers], axis=1)
    square = np.abs(motion) ** 2 / (np.max(np.abs(motion) ** 2) or 1.0)
    columns = np.concatenate([columns, (square * motion)[:, None]], axis=1) if bends else columns
    scale = weight / _clear_of_zero(near + 1j * omega * plain[1][0] - (plain[0][0] - centre**2))
    for _ in range(ROUNDS):
        left, right = columns * scale[:, None], target * scale
        left, right = np.concatenate([left.real, left.imag]), np.concatenate([right.real, right.imag])
        size = np.linalg.norm(left, axis=0)
        size = np.where(size > 0, size, 1.0)
        found = np.linalg.lstsq(left / size, right, rcond=1e-12)[0] / size
        operator = found[0] - near + 1j * omega * found[1] + (found[8] * square if bends else 0.0)
        scale = weight / _clear_of_zero(operator)
    stiffness, damping = found[0] + centre**2, found[1]
    rest = float(np.sum(np.abs((columns @ found - target) * scale) ** 2))
    if not (stiffness > 0 and damping > _NARROW * span / len(omega)):
        return Seen(None, rest, 0.0)
    pole = (np.sqrt(stiffness) + 0.5j * damping - centre) / span
    gain = np.polyval((found[2:5] + 1j * found[5:8])[::-1], pole)
    mobility = float(np.abs(gain) * (1.0 if gain.real >= 0 else -1.0))
    angle = float(np.angle(gain * np.sign(mobility)))
    return Seen((np.array([stiffness]), np.array([damping]), mobility), rest, angle)


def _clear_of_zero(operator: np.ndarray) -> np.ndarray:
    """The size of each, at least a part of the largest: without noise one may vanish."""
    size = np.abs(operator)
    return np.maximum(size, _VANISHES * size.max() or 1.0)


def of_modulus(omega, motion, force, weight):
    """The device of one axis behind amplitudes alone: 1/|X|² is a parabola in ω² − c·|X|², where c bends the resonance
    over, where that explains much more and leaves it in the band: a shunt, or a clip, looks like many widths of bend.
    """
    amplitude, drive = np.abs(motion[:, 0]), np.abs(force[:, 0])
    target, error = (drive / amplitude) ** 2, 2 * drive**2 / (amplitude**3 * weight)
    reach = _BENT * np.ptp(omega**2) / np.max(amplitude) ** 2
    bent = lambda c: _parabola(omega**2 - c * amplitude**2, target, error)  # noqa: E731
    misfit, straight = bent(0.0)
    near = lambda one: one and (not straight or min(omega) <= one.stiffness[0] ** 0.5 <= max(omega))  # noqa: E731
    net = np.linspace(-reach, reach, _BENDS)
    usable = [(one[0], c) for c in net if near((one := bent(c))[1])]
    if not usable:
        return straight
    best, step = min(usable)[1], net[1] - net[0]
    finer = [c for c in np.linspace(best - step, best + step, _FINER) if near(bent(c)[1])]
    less, device = bent(min(finer, key=lambda c: bent(c)[0]))
    return device if straight is None or less < _BETTER * misfit else straight


def _parabola(square, target, error):
    """Squared misfit of target = (K − square)²/σ² + D²·K/σ², and the device; `None` for what is none."""
    centre, span = square.mean(), np.ptp(square)
    columns = np.vander((square - centre) / span, 3) / error[:, None]
    found = np.linalg.lstsq(columns, target / error, rcond=1e-12)[0]
    misfit = float(np.sum((columns @ found - target / error) ** 2))
    bend, slope, level = found / np.array([span**2, span, 1.0])
    if bend <= 0:
        return misfit, None
    stiffness, dissipated = centre - slope / (2 * bend), (level - slope**2 / (4 * bend)) / bend
    if stiffness <= 0 or dissipated <= 0:  # the tip is not resolved
        return misfit, None
    return misfit, NormalisedDevice([stiffness], [np.sqrt(dissipated / stiffness)], 1 / np.sqrt(bend))
