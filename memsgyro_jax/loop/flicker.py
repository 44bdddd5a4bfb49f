"""Flicker of the read-out: a delay whose spectrum falls as 1/f over decades, drawn along the run.

What makes a bias wander is no voltage near zero frequency, which a demodulator does not hear, but a phase that wanders:
it turns quadrature into rate. The 1/f is a sum of first-order Gauss-Markov (Ornstein-Uhlenbeck) states, one for each
decade, all of one variance, each carried exactly over a sample of any length (S. Machlup, J. Appl. Phys. 25, 1954).
"""

import math

import equinox as eqx
import jax.numpy as jnp

from memsgyro_jax.base.arguments import arrays
from memsgyro_jax.base.display import Displayed
from memsgyro_jax.base.errors import InputError
from memsgyro_jax.device.gyro import Pair, Scalar, X, Y, check_positive, number


Held = tuple[Pair, ...]
# Deviation of a state over B: on the mean, f·S(f) of states a decade apart is their variance over ln 10.
_SHARE = math.sqrt(math.log(10.0) / math.pi)


class Flicker(Displayed):
    """A delay of the channels (x, y) with the one-sided density `delay`²/(π f) [s²/Hz], `delay` [s] being the
    coefficient B of IEEE 952: its Allan deviation is 0.664·B over any time well inside the band.

    The band goes from `lowest` [Hz], below which it is level, over `decades` to where it falls as 1/f². Within it the
    density ripples by 5.5 %. It begins in its stationary state. Zero is no flicker.
    """

    delay: Pair = arrays("s", metadata={"unit": "s"})
    lowest: Scalar = number("Hz", default=0.1)
    decades: int = eqx.field(static=True, default=5)

    def __check_init__(self):
        if len(self.delay) != 2:
            raise InputError(f"Argument `delay` must be a pair, for x and y, but {len(self.delay)} were given.")
        check_positive("lowest", self.lowest)
        if not 1 <= self.decades <= 12:
            raise InputError(f"Argument `decades` must lie between 1 and 12, but {self.decades} was given.")

    @property
    def corners(self) -> tuple[Scalar, ...]:
        """Frequencies [Hz] at which the states' densities have halved."""
        return tuple(self.lowest * 10.0**k for k in range(self.decades + 1))

    def init(self) -> Held:
        """Before the first sample, which draws the stationary state."""
        return ((jnp.zeros(()),) * 2,) * (self.decades + 1)

    def step(self, held: Held, draws: Held, sample: Scalar, period: Scalar) -> tuple[Held, Pair]:
        """The states a sample of `period` [s] later, from as many pairs of standard normal numbers, and the delay [s]
        of x and y; sample number 0 draws them.
        """
        begun, new = sample > 0, []
        for corner, was, drawn in zip(self.corners, held, draws, strict=True):
            turned = 2.0 * jnp.pi * corner * period
            stays = jnp.where(begun, jnp.exp(-turned), 0.0)
            fresh = jnp.where(begun, jnp.sqrt(-jnp.expm1(-2.0 * turned)), 1.0)
            new.append(tuple(stays * old + fresh * normal for old, normal in zip(was, drawn, strict=True)))
        late = tuple(_SHARE * self.delay[axis] * sum(pair[axis] for pair in new) for axis in (0, 1))
        return tuple(new), late


def check_flicker(flicker: Flicker | None, signals: tuple[int, int]) -> None:
    """Refuse a flicker where not displacement is measured: a delay needs the slope of what it delays.

    **Raises:** `InputError`.
    """
    if flicker is not None and signals != (X, Y):
        raise InputError("A read-out with `flicker` must measure displacement, but it shows another signal.")
