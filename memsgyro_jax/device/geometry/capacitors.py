"""Plates and combs: capacitance, force and electrostatic spring, without fringe fields."""

from typing import NamedTuple

from memsgyro_jax.base.concrete import check_positive
from memsgyro_jax.base.display import Displayed
from memsgyro_jax.base.fields import Scalar

from ..gyro import number


PERMITTIVITY_OF_VACUUM = 8.8541878128e-12  # F/m


class ParallelPlate(Displayed):
    """Plates of `area` [m²] at a `gap` [m] that closes: thesis (1.10) to (1.12), fringe absent (for sides far beyond
    the gap).
    """

    area: Scalar = number("m^2")
    gap: Scalar = number("m")

    def __check_init__(self):
        check_positive("area", self.area)
        check_positive("gap", self.gap)

    @property
    def capacitance(self) -> Scalar:
        """[F]."""
        return PERMITTIVITY_OF_VACUUM * self.area / self.gap

    def force(self, voltage: Scalar) -> Scalar:
        """[N], towards the other plate."""
        return 0.5 * self.capacitance / self.gap * voltage**2

    def stiffness(self, voltage: Scalar) -> Scalar:
        """[N/m], negative: the force grows as the gap closes."""
        return -self.capacitance / self.gap**2 * voltage**2


class Comb(Displayed):
    """`fingers` N gaps of `gap` Z, of fingers `thickness` W high that overlap by `overlap` x0 and `mismatch` d [m]: the
    overlap changes, the gap does not.

    Fringe and the fingers' tips are absent: overlaps of some gaps and more. Thesis (3.5) and (3.6).
    """

    fingers: Scalar = number()
    thickness: Scalar = number("m")
    gap: Scalar = number("m")
    overlap: Scalar = number("m")
    mismatch: Scalar = number("m", default=0.0)

    def __check_init__(self):
        for name in ("fingers", "thickness", "gap", "overlap"):
            check_positive(name, getattr(self, name))

    @property
    def gradient(self) -> Scalar:
        """dC/dx [F/m], thesis (3.5)."""
        return self.fingers * PERMITTIVITY_OF_VACUUM * self.thickness / self.gap

    @property
    def capacitance(self) -> Scalar:
        """At rest [F]."""
        return self.gradient * self.overlap

    @property
    def capacitance_mismatch(self) -> Scalar:
        """Difference of the two halves at rest [F], thesis (3.6)."""
        return 2.0 * self.gradient * self.mismatch

    def force(self, voltage: Scalar) -> Scalar:
        """[N], into the comb, the same at every overlap: a comb has no electrostatic spring."""
        return 0.5 * self.gradient * voltage**2


class DriveForce(NamedTuple):
    """Force [N] of a biased drive: steady, at the frequency of the alternating voltage, and at twice that."""

    steady: Scalar
    first: Scalar
    second: Scalar


def drive_force(gradient: Scalar, bias: Scalar, amplitude: Scalar) -> DriveForce:
    """½ C' (Vb + Vc cos ωt)² by its harmonics, thesis (3.15); `gradient` C' in F/m, voltages in V.

    A drive on both sides with opposite Vc has twice the first harmonic and neither of the others.
    """
    return DriveForce(
        0.5 * gradient * (bias**2 + 0.5 * amplitude**2), gradient * bias * amplitude, 0.25 * gradient * amplitude**2
    )
