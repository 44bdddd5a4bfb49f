"""The equations of motion as a table that is linear in its coefficients, and the matrices that it stands for."""

from dataclasses import dataclass
from typing import NamedTuple

import equinox as eqx

from memsgyro_jax.base.errors import InputError
from memsgyro_jax.base.fields import Scalar

from .small import Matrix, Vector, plus, times


# The signals an acceleration can be proportional to: displacement, velocity, applied force.
X, Y, VX, VY, UX, UY = range(6)


class Term(NamedTuple):
    """`factor * signal` in the acceleration of `axis` (0 for x, 1 for y)."""

    axis: int
    signal: int
    factor: float


@dataclass(frozen=True)
class Coefficient:
    """A mass-normalised coefficient of the equations of motion and the terms it multiplies.

    `is_rate` marks Coriolis terms, which a controller must not mistake for damping. A coefficient of a channel (0 for
    x, 1 for y) has no terms: `delays` a displacement read-out by a time in s, `scales` it up by a share.
    """

    name: str
    terms: tuple[Term, ...]
    is_rate: bool = False
    delays: int | None = None
    scales: int | None = None


class Dynamics(eqx.Module):
    """`acceleration = gain * force + bias - stiffness @ displacement - (damping + coriolis) @ velocity`.

    Stiffness in rad²/s², damping and Coriolis in 1/s, gain in 1/kg, bias in m/s²; rows are the axes x and y.
    """

    stiffness: Matrix = eqx.field(converter=Matrix)
    damping: Matrix = eqx.field(converter=Matrix)
    coriolis: Matrix = eqx.field(converter=Matrix)
    gain: Vector = eqx.field(converter=Vector)
    bias: Vector = eqx.field(converter=Vector, default=(0.0, 0.0))

    @property
    def velocity(self) -> Matrix:
        """Everything that multiplies the velocity: damping and Coriolis."""
        return self.damping + self.coriolis


@dataclass(frozen=True)
class MotionModel:
    """The equations of motion as a table, linear in mass-normalised coefficients (thesis (3.2) and (3.4)).

    Observers estimate the coefficients, controllers compensate them and the information bound differentiates by them:
    all read this one table.
    """

    coefficients: tuple[Coefficient, ...]

    def __repr__(self) -> str:
        return f"MotionModel of {', '.join(self.names)}"

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the coefficients in order."""
        return tuple(c.name for c in self.coefficients)

    def index(self, name: str) -> int:
        """Position of coefficient `name`; raises `InputError` for an unknown one."""
        if name not in self.names:
            raise InputError(f"A coefficient must be one of {', '.join(self.names)}, but `{name}` was given.")
        return self.names.index(name)

    def assemble(self, theta: tuple[Scalar, ...]) -> Dynamics:
        """The matrices that coefficients `theta` (in the order of `names`) stand for."""
        stiffness, damping, coriolis = ([[0.0, 0.0], [0.0, 0.0]] for _ in range(3))
        gain = [0.0, 0.0]
        for value, coefficient in zip(theta, self.coefficients, strict=True):
            for axis, signal, factor in coefficient.terms:
                if signal >= UX:
                    row, place, sign = gain, axis, 1.0
                elif signal >= VX:
                    row, place, sign = (coriolis if coefficient.is_rate else damping)[axis], signal - VX, -1.0
                else:
                    row, place, sign = stiffness[axis], signal, -1.0
                row[place] = plus(row[place], times(sign * factor, value))
        return Dynamics(stiffness, damping, coriolis, gain)


SINGLE_MASS = MotionModel(
    (
        Coefficient("rate", (Term(0, VY, 2.0), Term(1, VX, -2.0)), is_rate=True),
        Coefficient("kxx", (Term(0, X, -1.0),)),
        Coefficient("kyy", (Term(1, Y, -1.0),)),
        Coefficient("kxy", (Term(0, Y, -1.0), Term(1, X, -1.0))),
        Coefficient("dxx", (Term(0, VX, -1.0),)),
        Coefficient("dyy", (Term(1, VY, -1.0),)),
        Coefficient("dxy", (Term(0, VY, -1.0), Term(1, VX, -1.0))),
        Coefficient("sigma", (Term(0, UX, 1.0), Term(1, UY, 1.0))),
    )
)
"""Thesis (3.2): symmetric coupling, one mass; sigma = 1/m."""

DUAL_MASS = MotionModel(
    (
        Coefficient("rate_x", (Term(0, VY, 2.0),), is_rate=True),
        Coefficient("rate", (Term(1, VX, -2.0),), is_rate=True),
        Coefficient("kxx", (Term(0, X, -1.0),)),
        Coefficient("kyy", (Term(1, Y, -1.0),)),
        Coefficient("kxy", (Term(0, Y, -1.0),)),
        Coefficient("kyx", (Term(1, X, -1.0),)),
        Coefficient("dxx", (Term(0, VX, -1.0),)),
        Coefficient("dyy", (Term(1, VY, -1.0),)),
        Coefficient("sigma_x", (Term(0, UX, 1.0),)),
        Coefficient("sigma_y", (Term(1, UY, 1.0),)),
    )
)
"""Thesis (3.4): separate moving masses, no cross damping; rate_x = m1·Ω/(m1 + m2)."""
