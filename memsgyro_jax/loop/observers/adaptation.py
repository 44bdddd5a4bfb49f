"""How coefficients follow an error of the velocity, each by the signals it multiplies: L2 of thesis (4.11).

The gains have no units: motion in units of `length` [m], time in units of `1/frequency` [rad/s].
"""

from typing import Protocol

from memsgyro_jax.device.gyro import UX, VX, MotionModel, Pair, Scalar


class Adapting(Protocol):
    """What adapts: a gain and a unit for each coefficient of `model`, and the units of length and time."""

    @property
    def model(self) -> MotionModel: ...
    @property
    def adaptation(self) -> tuple[Scalar, ...]: ...
    @property
    def unit(self) -> tuple[Scalar, ...]: ...
    @property
    def length(self) -> Scalar: ...
    @property
    def frequency(self) -> Scalar: ...


def adapted(law: Adapting, theta: tuple[Scalar, ...], signals: tuple[Scalar, ...], driven: Pair) -> tuple[Scalar, ...]:
    """Each coefficient moved by its `signals` (x, y, vx, vy in m and m/s, forces in N) times the integrated error
    `driven` of their axes, without units.
    """
    new = []
    for value, unit, gain, coefficient in zip(theta, law.unit, law.adaptation, law.model.coefficients, strict=True):
        move = sum(
            factor * _scaled(law, signals[signal], signal, unit) * driven[axis]
            for axis, signal, factor in coefficient.terms
        )
        new.append(value + gain * unit * move)
    return tuple(new)


def adaptation_units(model: MotionModel, design: tuple[Scalar, ...], frequency: Scalar) -> tuple[Scalar, ...]:
    """The unit of each coefficient in scaled variables: ω² for stiffness, ω for damping and rate, the design value for
    1/mass.
    """
    units = []
    for value, coefficient in zip(design, model.coefficients, strict=True):
        signal = coefficient.terms[0].signal
        units.append(value if signal >= UX else frequency if signal >= VX else frequency**2)
    return tuple(units)


def first_guess(
    model: MotionModel, design: tuple[Scalar, ...], known: tuple[str, ...], start: Scalar
) -> tuple[tuple[Scalar, ...], tuple[float, ...]]:
    """Coefficients at `start` times the design's, those `known` at its full value, and the gains 1 and 0 by which they
    are adapted. Raises `InputError` for an unknown name.
    """
    fixed = {model.index(name) for name in known}
    theta = tuple(value * (1.0 if i in fixed else start) for i, value in enumerate(design))
    return theta, tuple(0.0 if i in fixed else 1.0 for i in range(len(design)))


def _scaled(law: Adapting, value: Scalar, signal: int, unit: Scalar) -> Scalar:
    """A signal without units; a force is measured by the acceleration it gives the nominal mass."""
    if signal >= UX:
        return value * unit / (law.length * law.frequency**2)
    return value / (law.length * law.frequency) if signal >= VX else value / law.length
