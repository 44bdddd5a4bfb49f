"""What the linearised loops of classic control count of a device's effects: that the read-out answers late."""

import jax.numpy as jnp

from memsgyro_jax.device.gyro import Pair, Scalar
from memsgyro_jax.effects.readout_delay import ReadoutDelay

from .loop import ClosedLoop
from .readout import Delayed


def delays(loop: ClosedLoop) -> Pair:
    """By how much x and y are shown late [s]: by `ReadoutDelay` of the device and by a `Delayed` read-out."""
    common: Scalar = sum((e.strength for e in loop.device.effects if isinstance(e, ReadoutDelay)), jnp.zeros(()))
    own = loop.readout.delay if isinstance(loop.readout, Delayed) else (0.0, 0.0)
    return common + own[0], common + own[1]


def uncounted_effects(loop: ClosedLoop) -> tuple[str, ...]:
    """Labels of the device's other effects, which its linearised loops do not count; none of strength zero."""
    return tuple(effect.label for effect in loop.device.present.effects if not isinstance(effect, ReadoutDelay))


def uncounted(labels: tuple[str, ...]) -> tuple[str, ...]:
    """A sentence that margins leave such effects out; none where there are none."""
    if not labels:
        return ()
    return (f"The margins leave out what these effects of the device do: {', '.join(labels)}; `simulate` counts them.",)
