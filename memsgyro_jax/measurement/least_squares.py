"""Maximum likelihood: a whitened residual and its slopes go in, the optimum and what the data hold of it come out.

Everything is written in operations that NumPy and JAX share: `least_squares` runs on the host over records that each
have a compiled program of their own (`diagnosis`), and inside one compiled program, for batches of noise draws
(`couplings`).
"""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import equinox as eqx
import numpy as np
from jaxtyping import Array, Float
from scipy import special

from memsgyro_jax.base.text import combination


NULL = 1e-7  # of the best held direction: information below which a direction counts as not held
PART = 1e-3  # share of a parameter in a null direction from which its own value is not held
AT_LEAST, HOPE = 3, 10.0  # evaluations before a fit is given up, where χ² falls by less than so many promised falls
BETTER, WORSE = 0.75, 0.01  # of the predicted fall of χ²: above it damping eases, below it a step is taken back
EASE = 8.0
LEVELS = 4.0 ** np.arange(-22, 31)  # dampings tried after a step that failed


def gate(count: float, width: float = 3.0, freedom: float = np.inf) -> float:
    """Largest χ² per reading (or degree of freedom) that noise alone explains: 1 + `width` standard deviations, of χ²
    and of a noise that was estimated with `freedom` degrees of freedom.
    """
    return 1.0 + width * (2.0 / count + 2.0 / freedom) ** 0.5


def above(chi2: float, count: int, freedom: float = np.inf) -> float:
    """Probability of a larger χ² of `count` readings by noise alone, which is known, or estimated with `freedom`
    degrees of freedom: then χ² per reading follows Fisher's distribution.
    """
    return float(special.chdtrc(count, chi2) if np.isinf(freedom) else special.fdtrc(count, freedom, chi2 / count))


class NullDirection(NamedTuple):
    """A combination of parameters that the data do not hold: `weights` (n,) in coordinates of equal sensitivity."""

    weights: np.ndarray
    names: tuple[str, ...]

    def __str__(self) -> str:
        return combination(self.weights, self.names)


class Information(eqx.Module):
    """What a whitened Jacobian (r, n) holds of n parameters.

    Args:
        size: residual per unit of each parameter alone, in standard deviations (n,).
        singular: of the Jacobian with columns of unit length (n,).
        directions: combinations of the parameters times `size` that belong to them, row by row (n, n).
    """

    size: Float[Array, " n"]
    singular: Float[Array, " n"]
    directions: Float[Array, "n n"]

    @classmethod
    def of(cls, jacobian: Float[Array, "r n"]) -> "Information":
        """Through the eigenvectors of the n × n product, twenty times cheaper than a decomposition of a tall Jacobian;
        what each of them moves is then measured on the Jacobian itself, exact far below `NULL`.
        """
        xp = jacobian.__array_namespace__()
        size = xp.sqrt(xp.sum(jacobian**2, axis=0))
        unit = jacobian / xp.where(size > 0, size, 1.0)
        vectors = xp.linalg.eigh(unit.T @ unit)[1]
        return cls(size, xp.sqrt(xp.sum((unit @ vectors) ** 2, axis=0)), vectors.T)

    @property
    def held(self) -> Array:
        """Which directions the data hold (n,)."""
        return self.singular > NULL * self.singular.max()

    @property
    def root(self) -> Float[Array, "n n"]:
        """R with covariance R·Rᵀ of what is held."""
        xp = self.size.__array_namespace__()
        inverse = xp.where(self.held, 1.0 / xp.where(self.held, self.singular, 1.0), 0.0)
        return (self.directions.T * inverse) / xp.where(self.size > 0, self.size, 1.0)[:, None]

    @property
    def loose(self) -> Array:
        """Which parameters have a part in a direction that is not held (n,)."""
        return ((abs(self.directions) > PART) & ~self.held[:, None]).any(axis=0)

    @property
    def covariance(self) -> Float[Array, "n n"]:
        """Inverse Fisher information of the parameters; the variance of those that are loose is infinite."""
        xp, loose = self.size.__array_namespace__(), self.loose
        return xp.where(xp.diag(loose), xp.inf, self.root @ self.root.T)

    @property
    def std(self) -> Float[Array, " n"]:
        """Standard deviation of each parameter; infinite where the data do not hold it."""
        xp = self.size.__array_namespace__()
        return xp.sqrt(xp.linalg.diagonal(self.covariance))

    def null_directions(self, names: Sequence[str]) -> tuple[NullDirection, ...]:
        """Combinations that the data do not hold, the largest part positive."""
        rows = np.asarray(self.directions)[~np.asarray(self.held)]
        return tuple(NullDirection(row * np.sign(row[np.argmax(np.abs(row))]), tuple(names)) for row in rows)


class Marquardt(NamedTuple):
    """Where Levenberg and Marquardt's method stands: its best place yet, with residual and slopes there, the damping,
    the eigenvalues and vectors of SᵀS, the gradient along those, and evaluations so far.
    """

    place: Array
    residual: Array
    slope: Array
    damping: Array
    squares: Array
    vectors: Array
    gradient: Array
    evaluations: Array

    @classmethod
    def at(cls, place: Array, residual: Array, slope: Array, damping: Any, evaluations: Any) -> "Marquardt":
        """At a place with known residual (r,) and slopes (r, k)."""
        xp = slope.__array_namespace__()
        squares, vectors = xp.linalg.eigh(slope.T @ slope)
        gradient = vectors.T @ (slope.T @ residual)
        return cls(place, residual, slope, damping, xp.where(squares > 0, squares, 0.0), vectors, gradient, evaluations)

    @property
    def chi2(self) -> Array:
        """Sum of squares."""
        return self.residual @ self.residual

    @property
    def move(self) -> Float[Array, " k"]:
        """The next step."""
        return -self.vectors @ (self.gradient / (self.squares + self.damping))

    @property
    def fall(self) -> Array:
        """By how much a linear residual would let χ² fall in that step."""
        return ((self.squares + 2 * self.damping) * (self.gradient / (self.squares + self.damping)) ** 2).sum()

    def hopeless(self, beat: float) -> Array:
        """Whether χ² will not get down to `beat`: what a linear residual promises, and much more, is not enough."""
        xp, held = self.slope.__array_namespace__(), self.squares > 0
        promised = xp.where(held, self.gradient**2 / xp.where(held, self.squares, 1.0), 0.0).sum()
        return (self.evaluations >= AT_LEAST) & (self.chi2 - HOPE * promised > beat)

    def settled(self, tolerance: float) -> Array:
        """Whether the next step moves the residual by less than `tolerance` standard deviations (of the misfit, where
        that exceeds the noise).
        """
        moved = (self.squares * (self.gradient / (self.squares + self.damping)) ** 2).sum()
        scatter = self.chi2 / self.residual.shape[0]
        return moved <= tolerance**2 * (scatter * (scatter > 1) + 1.0 * (scatter <= 1))

    def stronger(self) -> Array:
        """The damping, at least fourfold, that makes the step at most a quarter as long."""
        xp = self.slope.__array_namespace__()
        shares = self.gradient / (self.squares + xp.asarray(LEVELS)[:, None])
        short = 16.0 * (shares**2).sum(axis=1) <= self.move @ self.move
        return xp.where(short & (xp.asarray(LEVELS) >= 4 * self.damping), xp.asarray(LEVELS), LEVELS[-1]).min()

    def advanced(self, residual: Array, slope: Array) -> "Marquardt":
        """After the residual and slopes at place + move became known."""
        xp = self.slope.__array_namespace__()
        fall = self.chi2 - residual @ residual
        good = fall > WORSE * self.fall  # not so where anything is no number
        eased = xp.where(fall > BETTER * self.fall, self.damping / EASE, self.damping)
        return Marquardt.at(
            xp.where(good, self.place + self.move, self.place),
            xp.where(good, residual, self.residual),
            xp.where(good, slope, self.slope),
            xp.where(good, eased, self.stronger()),
            self.evaluations + 1,
        )


def on_host(going: Callable, advance: Callable, state: Marquardt) -> Marquardt:
    """What `jax.lax.while_loop` does, without compiling it."""
    while going(state):
        state = advance(state)
    return state


def least_squares(
    linearise: Callable[[Array], tuple[Array, Array]],
    first: tuple[Array, Array],
    *,
    damping: float,
    tolerance: float,
    evaluations: int,
    beat: float = np.inf,
    loop: Callable = on_host,
) -> Marquardt:
    """Move k coordinates from zero to the least sum of squares.

    Args:
        linearise: residual (r,) and its slopes (r, k) at a place (k,).
        first: those at zero. The slopes should have columns of about unit length: one is a standard deviation then.
        damping: to begin with, against squares of singular values at most k: 1e-12 is a step of Gauss and Newton.
        tolerance: stop when a step would move the residual by less standard deviations.
        evaluations: at most so many, the first included.
        beat: χ² from which the fit is of use; given up where it will not get there.
        loop: `on_host`, or `jax.lax.while_loop` within a compiled program.
    """
    residual, slope = first
    xp = slope.__array_namespace__()
    start = Marquardt.at(xp.zeros(slope.shape[1]), residual, slope, xp.asarray(float(damping)), xp.asarray(1))
    return loop(
        lambda state: (state.evaluations < evaluations) & ~state.settled(tolerance) & ~state.hopeless(beat),
        lambda state: state.advanced(*linearise(state.place + state.move)),
        start,
    )
