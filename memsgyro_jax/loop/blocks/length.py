"""How long a block is, and when its maps are made anew."""

from typing import NamedTuple

import equinox as eqx
import numpy as np
from jaxtyping import Bool, Int

from memsgyro_jax.base.concrete import is_concrete, settled
from memsgyro_jax.base.display import Displayed
from memsgyro_jax.base.errors import InputError
from memsgyro_jax.base.text import excerpt
from memsgyro_jax.device.gyro import AbstractGyro, DualMassGyro, mode_frequencies


_SHORTEST = 128  # samples of a block that is worth its maps
_SHARE = 2  # of what has passed, the inverse of the share that a growing block may take
_RENEWED = 16  # blocks after which maps are renewed at the latest


class Pace(NamedTuple):
    """Samples one by one that bring a filter near enough, and by what factor blocks may grow in number until maps are
    made anew, for kinds of devices: with the same noise a rate then ends where it ends sample by sample to 1 % of its
    claimed deviation for the devices of the thesis, and to 1.5 % for those of `studies/any_device.py`.
    """

    start: int
    factor: float


ONE_MASS, MATCHED_MODES, TWO_MASSES = Pace(512, 3.0), Pace(1024, 3.0), Pace(2048, 1.0)
_MATCHED = 0.02  # of a mode: nearer ones show their coefficients later (with 512 samples up to 7 % of a deviation)


def pace_of(gyro: AbstractGyro) -> Pace:
    """That of `gyro`; the longer one of its kind where its modes are not known, inside a transformation."""
    if isinstance(gyro, DualMassGyro):
        return TWO_MASSES
    still = settled(gyro)
    if not is_concrete(still):
        return MATCHED_MODES
    modes = mode_frequencies(still)
    return ONE_MASS if np.all(modes[..., 1] - modes[..., 0] > _MATCHED * modes[..., 0]) else MATCHED_MODES


class Blocks(Displayed):
    """Advances a loop by blocks of `length` samples, a power of two, after at least `start` samples one by one and
    blocks that grow: none is longer than half of what has passed before it.

    The filter must have come near enough by then that the device is linear in what it does not know yet; a `start` of
    None is 512 for one mass, 1024 where its modes are within 2 % of each other and 2048 for two masses, whose
    coefficients show themselves later. `projected` takes the noise of the very samples that the loop would draw one by
    one, instead of drawing a block's statistics: as dear as they are, for comparison. `alike` are the tones, counted
    along x and then y, that share a frequency; None where that is not known. `ramps` projects the samples on the modes
    times a ramp too, which the motion holds where a tone drives them; None adds them there.

    Raises `InputError` for a length that is no power of two, and a start below 1.
    """

    length: int = eqx.field(static=True, default=512)
    start: int | None = eqx.field(static=True, default=None)
    projected: bool = eqx.field(static=True, default=False)
    alike: tuple[tuple[int, ...], ...] | None = eqx.field(static=True, default=None)
    ramps: bool | None = eqx.field(static=True, default=None)

    def __check_init__(self):
        if not isinstance(self.length, int | np.integer) or self.length < 2 or self.length & (self.length - 1):
            raise InputError(
                f"Argument `length` of blocks must be a power of two, but {excerpt(self.length)} was given."
            )
        if self.start is not None and not (isinstance(self.start, int | np.integer) and self.start >= 1):
            raise InputError(f"Argument `start` of blocks must be at least 1, but {excerpt(self.start)} was given.")

    def first(self, samples: int, stride: int = 1) -> tuple[int, int]:
        """The samples run one by one and those in growing blocks, so that of `samples` a whole number of `stride`
        blocks is left; all of them one by one where they are too few.
        """
        whole = self.length * stride
        start = ONE_MASS.start if self.start is None else self.start
        least = min(max(start, self.length), samples)
        until = least + (samples - least) % whole
        alone = min(start, until)
        if until == samples:
            return until, 0
        alone += (until - alone) % min(_SHORTEST, self.length)
        return alone, until - alone

    def stride(self, samples: int, windows: int) -> int:
        """The blocks that make up a window, when a run of `samples` is to have about `windows`."""
        return max(1, samples // (self.length * windows))


def lengths(start: int, lead: int, length: int, stride: int, windows: int) -> Int[np.ndarray, "windows stride"]:
    """Samples of all blocks behind the first `start` samples, in windows of `stride` blocks: `lead` samples in growing
    blocks, the last window of which zeros fill, and `windows` of blocks of `length`.
    """
    place, end, growing = start, start + lead, []
    while place < end:
        growing.append(1 << (min(place // _SHARE, length, end - place).bit_length() - 1))
        place += growing[-1]
    growing += [0] * (-len(growing) % stride)
    return np.concatenate([np.reshape(np.array(growing, int), (-1, stride)), np.full((windows, stride), length)])


def renewals(sizes: Int[np.ndarray, "windows stride"], factor: float) -> Bool[np.ndarray, "windows stride"]:
    """Before which blocks maps are made: of growing blocks before each, then when the number of blocks has grown by
    `factor` (1: before each). What is known of a constant sharpens as a power of time, so that it moves as much from
    block 4 to 8 as from 8 to 16.
    """
    flat = sizes.ravel()
    even, last, made = int(np.argmax(flat == flat.max())) if flat.size else 0, 0, flat > 0
    for number in range(1, flat.size - even):
        made[even + number] = number >= min(factor * last, last + _RENEWED)
        last = number if made[even + number] else last
    return made.reshape(sizes.shape)
