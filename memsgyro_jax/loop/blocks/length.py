"""How long a block is, and when its maps are made anew."""

import equinox as eqx
import numpy as np
from jaxtyping import Bool

from memsgyro_jax.base.display import Displayed
from memsgyro_jax.base.errors import InputError


class Blocks(Displayed):
    """Advances a loop by blocks of `length` samples, a power of two, after at least `start` samples one by one.

    The filter must have come near enough by then that the device is linear in what it does not know yet. `projected`
    takes the noise of the very samples that the loop would draw one by one, instead of drawing a block's statistics: as
    dear as they are, for comparison. `alike` are the tones, counted along x and then y, that share a frequency; None
    where that is not known. Raises `InputError` for a length that is no power of two, and a start below 1.
    """

    length: int = eqx.field(static=True, default=512)
    start: int = eqx.field(static=True, default=512)
    projected: bool = eqx.field(static=True, default=False)
    alike: tuple[tuple[int, ...], ...] | None = eqx.field(static=True, default=None)

    def __check_init__(self):
        if self.length < 2 or self.length & (self.length - 1):
            raise InputError(f"Argument `length` of blocks must be a power of two, but {self.length} was given.")
        if self.start < 1:
            raise InputError(f"Argument `start` of blocks must be at least 1, but {self.start} was given.")

    def first(self, samples: int, stride: int = 1) -> int:
        """The samples run one by one, so that of `samples` a whole number of `stride` blocks is left; all of them where
        they are too few.
        """
        whole = self.length * stride
        least = min(self.start, samples)
        return least + (samples - least) % whole

    def stride(self, samples: int, windows: int) -> int:
        """The blocks that make up a window, when a run of `samples` is to have about `windows`."""
        return max(1, samples // (self.length * windows))


_RENEWED = 16  # blocks after which maps are renewed at the latest


def renewals(blocks: int, always: bool) -> Bool[np.ndarray, " blocks"]:
    """Before which blocks maps are made: what is known of a constant sharpens as a power of time, so that it moves as
    much from block 4 to 8 as from 8 to 16.
    """
    number = np.arange(blocks)
    return always | (number & (number - 1) == 0) | (number % _RENEWED == 0)
