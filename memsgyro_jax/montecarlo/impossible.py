"""Which drawn dies no device, read-out or filter can be, and why."""

from collections.abc import Sequence

import jax
import numpy as np
from jaxtyping import Bool

from memsgyro_jax.base.concrete import is_concrete
from memsgyro_jax.base.errors import InputError
from memsgyro_jax.loop.loop import ClosedLoop

from .batch import picked
from .vary import DEVICE_PREFIX


_TOO_NEAR = "Its modes would lie nearer to each other than its quadrature sets them apart."
_TOGETHER = "No device has these numbers together."


def cannot_be(loop: ClosedLoop, design: ClosedLoop) -> Bool[np.ndarray, " dies"]:
    """Which of the dies in `loop`, drawn about `design`, no device, read-out or filter can be.

    The parts check themselves, many dies at a time: by halves, a few bad ones among thousands are soon found.
    """
    drawn, plain = ((part.device, part.readout, part.filter) for part in (loop, design))
    varies = [v for v, p in zip(jax.tree.leaves(drawn), jax.tree.leaves(plain), strict=True) if np.ndim(v) > np.ndim(p)]
    bad = np.zeros(varies[0].shape[-1] if varies else 1, bool)
    waiting = [np.arange(len(bad))]
    while waiting:
        places = waiting.pop()
        if _fault(picked(drawn, plain, places) if varies and is_concrete(varies) else drawn) is None:
            continue
        bad[places] = len(places) == 1
        waiting += np.array_split(places, 2) if len(places) > 1 else []
    return bad


def _fault(parts: tuple) -> InputError | None:
    try:
        for part in parts:
            getattr(part, "__check_init__", lambda: None)()
    except InputError as error:
        return error
    return None


def why_none(loop: ClosedLoop, design: ClosedLoop, paths: Sequence[str]) -> str:
    """Why no device, read-out or filter can be that of `loop`, a die drawn about `design` by the numbers at `paths`."""
    names, stiffness = design.device.natural, getattr(loop.device, "kxx", 0.0)
    if names is None or not is_concrete(stiffness) or not np.isnan(stiffness).any():
        return str(_fault((loop.device, loop.readout, loop.filter)))
    # What a designer's names lead to is not a number where modes repel each other by more than they lie apart.
    by_name = all(path.removeprefix(DEVICE_PREFIX) in names.units for path in paths if path.startswith(DEVICE_PREFIX))
    return _TOO_NEAR if by_name else _TOGETHER
