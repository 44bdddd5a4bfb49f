"""Sections `[loop]`, `[spread]` and `[sweep]` of a study file."""

from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BeforeValidator, Field

from memsgyro_jax.base.complaints import Misplaced
from memsgyro_jax.base.quantity import (
    Also,
    Duration,
    FileSection,
    Hertz,
    In,
    Metre,
    Pair,
    Rate,
    Seed,
    Share,
    Speed,
    Whole,
    number_and_unit,
)
from memsgyro_jax.montecarlo.spread import AbstractDistribution, Normal, Spread, Uniform, Vary

from .laws import OfDevice, Positive


class Start(FileSection):
    """Section `[loop]`: where the mass starts, how far it may travel, and how the plant is computed."""

    displacement: Pair[Metre] | None = None
    """Displacement (x, y) at time zero. Left out, 2 % of `travel` along x; at rest under a classic controller, on its
    reference motion under sliding mode."""
    velocity: Pair[Speed] = (0.0, 0.0)
    """Velocity (x, y) at time zero."""
    travel: Annotated[float, Field(gt=0.0), In("m")] | None = None
    """How far the mass may move: a die beyond it is lost. Left out, as far as the read-out follows."""
    discretisation: OfDevice = "exact"
    """How the device is computed over a sample: exactly, effects as kicks at both its ends; by the thesis' forward
    Euler; or integrated to a tolerance, effects at every moment, some hundred times slower."""
    block: Annotated[Whole, Field(ge=2)] | None = None
    """Number of samples, a power of two, by which a linear loop is advanced at once (`ClosedLoop.in_blocks`); left out,
    sample by sample."""


def _with_unit(given: Any) -> str:
    """A quantity whose unit depends on what it varies, kept as text."""
    number, unit = number_and_unit(given)
    return f"{number!r} {unit}".strip()


Quantity = Annotated[str, BeforeValidator(_with_unit), Also(quantity="")]


class Bell(FileSection):
    """`{ kind = "normal", relative = "10 %" }` or with `std`: a normal distribution about the design value."""

    kind: Literal["normal"]
    relative: Share = 0.0
    """Standard deviation (1σ) as a share of the design value."""
    std: Quantity | None = None
    """Standard deviation (1σ) in the unit of the number that varies; beside `relative`, added as squares."""
    cut: Positive = 4.0
    """Number of standard deviations at which the distribution ends."""

    def build(self, unit: str | None) -> AbstractDistribution:
        """The distribution of a parameter measured in `unit`."""
        return Normal(self.relative, within(self.std, unit, "std") if self.std else 0.0, self.cut)


class Box(FileSection):
    """`{ kind = "uniform", relative = "10 %" }` or with `low` and `high`: a uniform distribution."""

    kind: Literal["uniform"]
    relative: Share | None = None
    """Half width as a share of the design value; instead of `low` and `high`."""
    low: Quantity | None = None
    """Least value, in the unit of the number that varies."""
    high: Quantity | None = None
    """Largest value, in the unit of the number that varies."""

    def build(self, unit: str | None) -> AbstractDistribution:
        """The distribution of a parameter measured in `unit`."""
        ends = {"low": self.low, "high": self.high}
        given = {name: within(end, unit, name) for name, end in ends.items() if end is not None}
        return Uniform(self.relative, **given)


def within(given: str, unit: str | None, name: str) -> float:
    """A quantity in `unit`; raises `ValueError` where that is not known or of another kind."""
    if unit is None:
        raise ValueError(f"the unit of this parameter is not known, so `{name}` cannot be given")
    try:
        return In(unit).read(given)
    except ValueError as error:
        if number_and_unit(given)[1] != "%":
            raise
        raise ValueError(f"{str(error).rstrip('.')}; a share of the design value is given as `relative`") from error


class SpreadSection(FileSection):
    """Section `[spread]`: what differs from die to die."""

    relative: Share = 0.0
    """Standard deviation (1σ) of every physical number of the device as a share of it; of a coupling, of itself or of 1
    % of the main coefficients, whichever is more. Zero leaves all but `parameters` at the design."""
    shared: Annotated[float, Field(ge=0.0, lt=1.0), In("1")] = 0.0
    """Correlation, from 0 to below 1, of what `relative` spreads within stiffnesses, within dampings, within masses."""
    quasi: bool = True
    """Whether dies follow a scrambled Sobol sequence, by which percentiles converge faster, or are pseudo-random."""
    parameters: dict[str, Annotated[Bell | Box, Field(discriminator="kind")]] = Field(default_factory=dict)
    """Single numbers that follow their own law, by name: "device.kxx", "device.quadrature", "device.frequency.1",
    "readout.opamp_offset.0". A quadrature or frequency takes the place of the coefficient that it stands for."""
    correlation: tuple[tuple[float, ...], ...] | None = None
    """Correlation matrix over `parameters` in their order, with `relative = 0`; left out, they are independent."""

    def build(self, unit_of: Any) -> Spread:
        """The spread; `unit_of` gives the unit of a path. Raises `ValueError` for a unit of another kind."""
        if self.correlation is not None and self.relative > 0.0:
            raise ValueError("correlation needs relative = 0, so that each row belongs to one of the parameters")
        if self.shared > 0.0 and self.relative == 0.0:
            raise ValueError(
                "shared is the correlation of what relative spreads, which is zero; give relative, or the correlation "
                "of the parameters"
            )
        items = []
        for path, law in self.parameters.items():
            try:
                items.append(Vary(path, law.build(unit_of(path))))
            except ValueError as error:
                raise Misplaced(("parameters", path), error) from error
        everywhere = Normal(relative=self.relative) if self.relative > 0.0 else None
        return Spread(tuple(items), self.correlation, self.quasi, everywhere, shared=self.shared)


class SweepSection(FileSection):
    """Section `[sweep]`: how many dies, how long and how finely."""

    dies: Annotated[Whole, Field(ge=1)] = 256
    """Number of dies."""
    sample_rate: Hertz | None = None
    """Sample rate of the loop; left out, 26.6 samples in a period of the higher mode."""
    duration: Duration | None = None
    """Simulated time of a run; left out, 10 000 samples of the sample rate that is usual for the device."""
    settle: Annotated[float, Field(ge=0.0), In("s")] | None = None
    """Time from which statistics over time count; left out, half the duration."""
    tolerance: Annotated[Rate, Field(gt=0.0)] = float(np.radians(20.0))
    """Rate error within which a die yields at the end of its run, and has converged once it stays there; left out,
    20 °/s."""
    seed: Seed = 0
    """Number of the lot: a die is defined by it and by its own number, whatever else is asked for."""
    chunk: Annotated[Whole, Field(ge=1)] | None = None
    """Number of dies in a batch on one processor or card; changes no result. Left out, as suits the machine."""
