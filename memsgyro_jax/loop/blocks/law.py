"""What a loop's parts are in a block, read off the functions that act on a sample: the law of the command, the rows of
the read-out, the frequencies of what swings.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from memsgyro_jax.base.concrete import is_concrete, settled
from memsgyro_jax.base.fields import Scalar
from memsgyro_jax.device.gyro import AbstractGyro, Dynamics, mode_frequencies

from ..controllers.base import AbstractLinearController, Tone
from ..observers.base import AbstractObserver, Clock, Estimate
from ..readout import AbstractReadout
from .algebra import over_lanes


Groups = tuple[tuple[int, ...], ...]
Lanes = tuple[int, ...]
UNITS = tuple(tuple(float(i == j) for j in range(4)) for i in range(4))
REST = (0.0, 0.0, 0.0, 0.0)


def tones_of(controller: AbstractLinearController) -> tuple[Tone, ...]:
    """Those along x, then those along y."""
    return (*controller.tones[0], *controller.tones[1])


def same_frequency(controller: AbstractLinearController, apart: bool) -> Groups:
    """The tones that share a frequency, by their places; each by itself where that is not known, or `apart`."""
    tones = tones_of(controller)
    if apart or not is_concrete(tuple(tone.frequency for tone in tones)):
        return tuple((place,) for place in range(len(tones)))
    values = [tuple(np.ravel(tone.frequency).tolist()) for tone in tones]
    return tuple(tuple(i for i, v in enumerate(values) if v == one) for one in dict.fromkeys(values))


def law_of(
    controller: AbstractLinearController, observer: AbstractObserver, theta: tuple[Scalar, ...], groups: Groups,
    period: Scalar, lanes: Lanes,
) -> Float[Array, "2 signals lanes"]:  # fmt: skip
    """L of `force = L w` at coefficients `theta`; w is the estimated motion and, for each group of tones, the sine and
    the cosine of 2πft.
    """
    clock = Clock(jnp.zeros(()), jnp.zeros((), int), period)

    def force(motion: tuple[float, ...], heard: tuple[int, ...], ahead: float) -> Array:
        """The command with the tones `heard` alone, `ahead` [rad] of their phase at time zero."""
        sounding = [
            Tone(tone.frequency, tone.amplitude if place in heard else 0.0 * tone.amplitude, tone.phase + ahead)
            for place, tone in enumerate(tones_of(controller))
        ]
        along_x = len(controller.tones[0])
        sounding = (tuple(sounding[:along_x]), tuple(sounding[along_x:]))
        made = eqx.tree_at(lambda c: c.tones, controller, sounding)
        estimate = Estimate(motion, theta, (0.0, 0.0), observer.model)
        return over_lanes(made.command((), estimate, clock)[0], lanes)

    columns = [force(unit, (), 0.0) for unit in UNITS]
    for group in groups:
        columns += [force(REST, group, 0.5 * np.pi), force(REST, group, 0.0)]
    return jnp.stack(columns, axis=1)


def strikes_modes(controller: AbstractLinearController, gyro: AbstractGyro) -> bool:
    """Whether a tone lies so near a mode that the motion of some die grows from sample to sample; where that is not
    known, too.
    """
    struck = settled([tone.frequency for tone in tones_of(controller)])
    modes = mode_frequencies(settled(gyro))
    if not is_concrete(struck, modes):
        return bool(struck)
    return any(np.any(np.abs(frequency / np.ravel(modes) - 1.0) < _NEAR) for frequency in np.hstack([*struck, []]))


_NEAR = 0.3  # of a mode: three standard deviations of one whose stiffness and mass vary by 15 %


def pulsations(
    controller: AbstractLinearController, dynamics: Dynamics, groups: Groups, lanes: Lanes, apart: Scalar | None
) -> tuple[Float[Array, "frequencies lanes"], Float[Array, "tones lanes"]]:
    """ω [rad/s] of all that swings, and of the tones alone; with one more for each mode, by `apart` [rad/s] higher: the
    difference of two such neighbours is a ramp times a sine, as a tone on a mode drives it.

    No derivative: any frequencies give consistent statistics, these the fullest.
    """
    (a, b), (c, d) = over_lanes(dynamics.stiffness, lanes)
    mean, half = 0.5 * (a + d), jnp.sqrt(jnp.maximum(0.25 * (a - d) ** 2 + b * c, 0.0))
    modes = [jnp.sqrt(jnp.maximum(square, 0.0)) for square in (mean - half, mean + half)]
    tones, own = tones_of(controller), controller.frequencies
    heard = [2.0 * jnp.pi * over_lanes(tones[group[0]].frequency, lanes) for group in groups]
    others = [2.0 * jnp.pi * over_lanes(frequency, lanes) for frequency in own]
    tonal = jnp.stack(heard) if heard else jnp.zeros((0, *lanes))
    beside = [] if apart is None else [mode + apart for mode in modes]
    return jax.lax.stop_gradient(jnp.stack([*modes, *heard, *others, *beside])), tonal


def rows_of_readout(readout: AbstractReadout, lanes: Lanes) -> Float[Array, "2 4 lanes"]:
    """C of `volts = C motion + offset`."""
    silent, nothing = over_lanes(readout.clean(REST, (0.0, 0.0)), lanes), (0.0, 0.0)
    return jnp.stack([over_lanes(readout.clean(unit, nothing), lanes) - silent for unit in UNITS], axis=1)
