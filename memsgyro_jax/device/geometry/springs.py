"""Springs of slender straight beams: Euler and Bernoulli, small displacements, rigid anchors and mass."""

from collections.abc import Sequence
from typing import NamedTuple

import jax.numpy as jnp

from memsgyro_jax.base.concrete import check_positive
from memsgyro_jax.base.display import Displayed
from memsgyro_jax.base.fields import Scalar

from ..gyro import number


class PlaneStiffness(NamedTuple):
    """Stiffness in N/m of a spring in the plane, `[[xx, xy], [xy, yy]]`, whose end moves without turning."""

    xx: Scalar
    yy: Scalar
    xy: Scalar


class Beam(Displayed):
    """A straight beam along its `length` L, of `width` a in the plane and `thickness` b out of it [m], of Young's
    modulus `young` [Pa]; `stress` [Pa] pulls along it (zero: none).

    Slender, L >= 10 a: shear, left out, adds about (a/L)² to the compliance. Raises `InputError` unless dimensions and
    modulus are positive.
    """

    length: Scalar = number("m")
    width: Scalar = number("m")
    thickness: Scalar = number("m")
    young: Scalar = number("Pa")
    stress: Scalar = number("Pa", default=0.0)

    def __check_init__(self):
        for name in ("length", "width", "thickness", "young"):
            check_positive(name, getattr(self, name))

    @property
    def bending(self) -> Scalar:
        """E·I in the plane [N·m²], I = b a³/12."""
        return self.young * self.thickness * self.width**3 / 12.0

    @property
    def axial(self) -> Scalar:
        """K_x = E a b/L (thesis 1.3) [N/m]."""
        return self.young * self.width * self.thickness / self.length

    @property
    def cantilever(self) -> Scalar:
        """K_y = E a³ b/(4 L³) of the free end (thesis 1.2) [N/m]; `stress` is relieved there and does nothing."""
        return 3.0 * self.bending / self.length**3

    @property
    def cantilever_across(self) -> Scalar:
        """K_z = E a b³/(4 L³), out of the plane (thesis 1.3) [N/m]."""
        return self.young * self.width * self.thickness**3 / (4.0 * self.length**3)

    @property
    def guided(self) -> Scalar:
        """12 E I/L³ of an end that moves without turning, and 6 N/(5 L) of a tension N = stress·a·b [N/m].

        The tension's part is first order (the stiffness by stress of the beam's own shape): within 0.2 % for
        |N| L² <= E I.
        """
        pull = 1.2 * self.stress * self.width * self.thickness / self.length
        return 12.0 * self.bending / self.length**3 + pull


def in_series(*stiffness: Scalar) -> Scalar:
    """Stiffness of springs one behind the other.

    A folded flexure of one truss is two outer legs and two inner ones, `in_series(2 * outer.guided, 2 * inner.guided)`:
    2 E a³ b/(L1³ + L2³), thesis (1.6). The usual flexure has two of them, side by side, and twice the stiffness.
    """
    return 1.0 / sum(1.0 / each for each in stiffness)


def polyline(
    points: Sequence[tuple[Scalar, Scalar]], width: Scalar, thickness: Scalar, young: Scalar
) -> PlaneStiffness:
    """The spring that runs from an anchor at the first of `points` (x, y) [m] through the others to a mass that holds
    its end from turning: crab legs, U folds, hairpins, serpentines. `width` [m] is of every leg, or one per leg.

    By Castigliano's theorem, bending and stretch of each leg, exact for such beams (Timoshenko and Young, Theory of
    Structures). Legs are to be much longer than wide.
    """
    legs = len(points) - 1
    widths = list(width) if isinstance(width, tuple | list) else [width] * legs
    xx = yy = xy = xt = yt = tt = 0.0
    end = points[-1]
    for (x0, y0), (x1, y1), a in zip(points[:-1], points[1:], widths, strict=True):
        dx, dy = x1 - x0, y1 - y0
        length = jnp.sqrt(dx**2 + dy**2)
        bend = length / (young * thickness * a**3 / 12.0)
        stretch = 1.0 / (young * a * thickness * length)  # times components of the leg
        # Lever arms of unit forces at the end about the middle of the leg, and their spread along it.
        along, up = end[0] - 0.5 * (x0 + x1), end[1] - 0.5 * (y0 + y1)
        xx = xx + bend * (up**2 + dy**2 / 12.0) + stretch * dx**2
        yy = yy + bend * (along**2 + dx**2 / 12.0) + stretch * dy**2
        xy = xy - bend * (along * up + dx * dy / 12.0) + stretch * dx * dy
        xt, yt, tt = xt - bend * up, yt + bend * along, tt + bend
    # Without turning: the end's moment takes its own share of the compliance away.
    xx, yy, xy = xx - xt**2 / tt, yy - yt**2 / tt, xy - xt * yt / tt
    determinant = xx * yy - xy**2
    return PlaneStiffness(yy / determinant, xx / determinant, -xy / determinant)


def crab_leg_coupling(bending: Scalar, first: Scalar, second: Scalar) -> Scalar:
    """k_xy = 9 E I/(La Lb (La + Lb)) [N/m], of legs `first` La and `second` Lb at a right angle, without stretch.

    With the legs along +x and +y from the anchor it is positive, and never zero: only legs mirrored to it cancel it.
    `bending` is E I [N·m²].
    """
    return 9.0 * bending / (first * second * (first + second))


def u_fold_coupling(bending: Scalar, first: Scalar, second: Scalar, connector: Scalar) -> Scalar:
    """3 E I (L1 − L2)/(Lc L1³) [N/m], thesis (1.14): the first order for a U fold of nearly equal legs and
    Lc much shorter than they, 0.88 to 1.20 of the exact `polyline` there; it is none of a crab leg.

    E I is that of the legs [N·m²]; zero means legs of equal length.
    """
    return 3.0 * bending * (first - second) / (connector * first**3)


def hairpin(
    leg: Scalar, connector: Scalar, turns: int, width: Scalar, thickness: Scalar, young: Scalar
) -> PlaneStiffness:
    """A serpentine along x: `turns` times a `leg` up, a `connector` along x, the leg down and a connector [m].

    The closed forms of thesis (1.7) are not used: its K_x is a limit, and its K_z belongs to no such spring.
    """
    x, points = 0.0, [(0.0, 0.0)]
    for _ in range(turns):
        points += [(x, leg), (x + connector, leg), (x + connector, 0.0), (x + 2.0 * connector, 0.0)]
        x = x + 2.0 * connector
    return polyline(points, width, thickness, young)
