"""What the frame does to the device."""

from typing import NamedTuple

from .small import Matrix, Scalar


Pair = tuple[Scalar, Scalar]
Change = tuple[Scalar, Scalar, Scalar]
UNCHANGED: Change = (0.0, 0.0, 0.0)


class Inertial(NamedTuple):
    """What the frame does to the device at one moment; every field zero means a resting frame and an undisturbed
    device.

    `rate` Ωz and `cross_rate` (Ωx, Ωy) in rad/s, `angular_acceleration` dΩz/dt in rad/s², `acceleration` of the frame
    in m/s²; `damping_change` is the relative change of (dxx, dyy, dxy).
    """

    rate: Scalar = 0.0
    angular_acceleration: Scalar = 0.0
    cross_rate: Pair = (0.0, 0.0)
    acceleration: Pair = (0.0, 0.0)
    damping_change: Change = UNCHANGED


def frame_stiffness(inertial: Inertial, x_share: Scalar) -> Matrix:
    """Apparent stiffness per mass of a rotating frame (2.4); `x_share` is the part of the x-moving mass that also moves
    along y.
    """
    rate, (rate_x, rate_y) = inertial.rate, inertial.cross_rate
    product, spin = rate_x * rate_y, inertial.angular_acceleration
    return Matrix(((-(rate_y**2 + rate**2), x_share * (product - spin)), (product + spin, -(rate_x**2 + rate**2))))
