"""Section `[filter]` of a study file: what smooths the estimated rate into the loop's output."""

from typing import Annotated, Literal

from pydantic import Field, model_validator

from memsgyro_jax.base.quantity import FileSection, Hertz, Whole
from memsgyro_jax.loop.filters import AbstractFilter, Bandpass, Lowpass


Order = Annotated[Whole, Field(ge=1, le=4)]


class LowpassFilter(FileSection):
    """`kind = "lowpass"`: a Butterworth low-pass."""

    kind: Literal["lowpass"]
    bandwidth: Hertz
    """Bandwidth (-3 dB): where the power has halved."""
    order: Order = 3
    """Order, the number of poles."""

    def build(self) -> AbstractFilter:
        """The filter."""
        return Lowpass(self.bandwidth, self.order)


class BandpassFilter(FileSection):
    """`kind = "bandpass"`: a Butterworth band-pass."""

    kind: Literal["bandpass"]
    low: Hertz
    """Lower end of the band (-3 dB)."""
    high: Hertz
    """Upper end of the band (-3 dB)."""
    order: Order = 1
    """Half the number of poles."""

    @model_validator(mode="after")
    def _has_a_band(self) -> "BandpassFilter":
        if not self.low < self.high:
            raise ValueError(f"must have low below high, but has {self.low:g} Hz and {self.high:g} Hz")
        return self

    def build(self) -> AbstractFilter:
        """The filter."""
        return Bandpass(self.low, self.high, self.order)


Filter = Annotated[LowpassFilter | BandpassFilter, Field(discriminator="kind")]
