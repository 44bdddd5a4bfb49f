"""What a Kalman filter of a study file believes at its start, and what it expects to walk."""

from typing import Annotated

from pydantic import Field

from memsgyro_jax.base.quantity import FileSection, In, Metre, Pair, Share
from memsgyro_jax.device.gyro import AbstractGyro
from memsgyro_jax.loop.observers.settings import ProcessNoise


class PriorSpread(FileSection):
    """Standard deviations (1σ) of what the filter believes at the start; zero means known exactly."""

    spread: Share | None = None
    """That of every physical number of the device as a share of its design value; left out, that of `[spread]`, or 15 %
    where it has none."""
    rate_std: Annotated[float, Field(ge=0.0), In("rad/s")] = 3.0
    """That of the rate, about zero."""
    offset_std: Annotated[float, Field(ge=0.0), In("V")] = 20e-3
    """That of the offsets of the read-out, about zero."""
    amplitude: Metre | None = None
    """Displacement along x at which the filter starts; left out, the true one."""
    motion_error: Share = 0.05
    """That of the displacement as a share of `amplitude`; that of the velocity is as much times the natural
    frequency."""


_Walk = Annotated[float, Field(ge=0.0), In("rad^2/s^3")]
_StiffnessWalk = Annotated[float, Field(ge=0.0), In("1/s^5")]
_DampingWalk = Annotated[float, Field(ge=0.0), In("1/s^3")]
_MassWalk = Annotated[float, Field(ge=0.0), In("1/(kg^2*s)")]


class Walks(FileSection):
    """Random-walk intensities in (unit of the entry)²/s; what is not named does not walk."""

    rate: _Walk | None = None
    """Of the rate: K² of the rate random walk (IEEE 952)."""
    rate_x: _Walk | None = None
    """Of the rate as it acts on x of two masses, m1/(m1 + m2) of it."""
    kxx: _StiffnessWalk | None = None
    """Of the stiffness along x per mass."""
    kyy: _StiffnessWalk | None = None
    """Of the stiffness along y per mass."""
    kxy: _StiffnessWalk | None = None
    """Of the coupling per mass; of two masses, of the force on x."""
    kyx: _StiffnessWalk | None = None
    """Of the coupling per mass of two masses, of the force on y."""
    dxx: _DampingWalk | None = None
    """Of the damping along x per mass."""
    dyy: _DampingWalk | None = None
    """Of the damping along y per mass."""
    dxy: _DampingWalk | None = None
    """Of the cross damping per mass; two masses have none."""
    sigma: _MassWalk | None = None
    """Of 1/mass, of one mass."""
    sigma_x: _MassWalk | None = None
    """Of 1/mass of x, of two masses."""
    sigma_y: _MassWalk | None = None
    """Of 1/mass of y, of two masses."""
    offset: Pair[Annotated[float, Field(ge=0.0), In("V^2/s")]] = (0.0, 0.0)
    """Of the offsets of the read-out."""
    position: Pair[Annotated[float, Field(ge=0.0), In("m^2/s")]] = (0.0, 0.0)
    """Of the displacements."""
    velocity: Pair[Annotated[float, Field(ge=0.0), In("m^2/s^3")]] = (0.0, 0.0)
    """Of the velocities, as a white acceleration of that two-sided density makes them walk."""

    def build(self, gyro: AbstractGyro) -> ProcessNoise:
        """The process noise; raises `InputError` for a coefficient that the device does not have."""
        given = self.numbers()
        offset, motion = given.pop("offset"), (*given.pop("position"), *given.pop("velocity"))
        theta = ProcessNoise.of(gyro.model, **{name: value for name, value in given.items() if value is not None}).theta
        return ProcessNoise(motion, offset, theta).shaken_as(gyro)
