"""Sections `[loop]`, `[spread]` and `[sweep]` of a study file."""

from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BeforeValidator, Field

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

from .laws import Discretisation, Positive


class Start(FileSection):
    """Section `[loop]`: where the mass starts, how far it may travel, and how the plant is computed.

    Left out, the travel is the read-out's, and the mass starts at 2 % of it along x. `block`, a power of two, is how
    many samples are taken at a time (`ClosedLoop.in_blocks`); left out, one.
    """

    displacement: Pair[Metre] | None = None
    velocity: Pair[Speed] = (0.0, 0.0)
    travel: Annotated[float, Field(gt=0.0), In("m")] | None = None
    discretisation: Discretisation = "exact"
    block: Annotated[Whole, Field(ge=2)] | None = None


def _with_unit(given: Any) -> str:
    """A quantity whose unit depends on what it varies, kept as text."""
    number, unit = number_and_unit(given)
    return f"{number!r} {unit}".strip()


Quantity = Annotated[str, BeforeValidator(_with_unit), Also(quantity=True)]


class Bell(FileSection):
    """`{ kind = "normal", relative = "10 %" }` or `std` in the parameter's unit, cut at `cut` standard deviations."""

    kind: Literal["normal"]
    relative: Share = 0.0
    std: Quantity | None = None
    cut: Positive = 4.0

    def build(self, unit: str | None) -> AbstractDistribution:
        """The distribution of a parameter measured in `unit`."""
        return Normal(self.relative, within(self.std, unit, "std") if self.std else 0.0, self.cut)


class Box(FileSection):
    """`{ kind = "uniform", relative = "10 %" }`, the half width, or `low` and `high` in the parameter's unit."""

    kind: Literal["uniform"]
    relative: Share | None = None
    low: Quantity | None = None
    high: Quantity | None = None

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
    """Section `[spread]`: what differs from die to die.

    `relative` holds for every physical parameter of the device (correlated by `shared` within stiffnesses, dampings and
    masses; a coupling varies by it of itself or of 1 % of the main coefficients, whichever is more), `parameters` names
    single ones (`"device.kxx"`, `"device.quadrature"`, `"device.frequency.1"`, `"readout.opamp_offset.0"`), which then
    follow their own law, as does the coefficient that a quadrature or frequency stands for. `correlation` is over
    `parameters` in their order and needs `relative = 0`.
    """

    relative: Share = 0.0
    shared: Annotated[float, Field(ge=0.0, lt=1.0), In("1")] = 0.0
    quasi: bool = True
    parameters: dict[str, Annotated[Bell | Box, Field(discriminator="kind")]] = Field(default_factory=dict)
    correlation: tuple[tuple[float, ...], ...] | None = None

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
                raise ValueError(f'parameters."{path}": {error}') from error
        everywhere = Normal(relative=self.relative) if self.relative > 0.0 else None
        return Spread(tuple(items), self.correlation, self.quasi, everywhere, shared=self.shared)


class SweepSection(FileSection):
    """Section `[sweep]`: how many dies, how long and how finely.

    Left out, the higher mode is sampled 26.6 times per period, for 10 000 samples of that rate.
    Statistics over time start at `settle` (half the duration when left out). A die yields when its rate error at the
    end is within `tolerance`, and has converged when it stays there. `chunk` is the number of dies per device and
    batch.
    """

    dies: Annotated[Whole, Field(ge=1)] = 256
    sample_rate: Hertz | None = None
    duration: Duration | None = None
    settle: Annotated[float, Field(ge=0.0), In("s")] | None = None
    tolerance: Annotated[Rate, Field(gt=0.0)] = float(np.radians(20.0))
    seed: Seed = 0
    chunk: Annotated[Whole, Field(ge=1)] | None = None
