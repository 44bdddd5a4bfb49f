"""The least-squares line of a rate-table test, and figures that are linear in what leaves it."""

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from .plateau_noise import Response
from .rate_design import TREND, Design
from .rate_plateaus import RatePlateaus
from .scale_factor_result import MeasuredFigure


LEVEL = 0.95
PPM = 1e6


class Ranged(NamedTuple):
    """A figure with half of its 95 % interval, infinite where nothing tells it."""

    value: float
    reach: float

    @property
    def told(self) -> bool:
        """Whether it is not zero."""
        return abs(self.value) > self.reach

    def figure(self, title: str, unit: str, verdict: str = "") -> MeasuredFigure:
        """As it is printed."""
        return MeasuredFigure(title, self.value, self.value - self.reach, self.value + self.reach, unit, verdict)


@dataclass(frozen=True)
class Line:
    """The least-squares line over all plateaus, and what leaves it.

    Args:
        read, design, found: plateaus, their columns, and the response to the rate.
        full_scale: [rad/s].
    """

    read: RatePlateaus
    design: Design
    found: Response
    full_scale: float

    @cached_property
    def rate(self) -> Float[np.ndarray, " n"]:
        """Of each plateau, the same for those of one rate [deg/s]."""
        return np.degrees(self.design.place * np.max(np.abs(self.read.rate)))

    @cached_property
    def weights(self) -> Float[np.ndarray, "2 n"]:
        """What the response is multiplied with to be zero-rate output and scale factor."""
        return np.linalg.pinv(np.column_stack([np.ones(len(self.rate)), self.rate]))

    @cached_property
    def scale_factor(self) -> float:
        """[unit per deg/s]."""
        return float(self.weights[1] @ self.found.output)

    @property
    def ppm(self) -> float:
        """What an output is multiplied with to be ppm of the full scale, positive where it tells of a greater rate."""
        return PPM / (self.scale_factor * float(np.degrees(self.full_scale)))

    def of(self, weights: np.ndarray) -> Ranged:
        """A figure that is linear in the response."""
        return self.of_draws(float(weights @ self.found.output), self.found.outputs @ weights)

    def of_draws(self, value: float, draws: np.ndarray) -> Ranged:
        """A figure by its draws."""
        if not self.known:
            return Ranged(value, np.inf)
        return Ranged(value, float(np.quantile(np.abs(draws - value), LEVEL)))

    @property
    def known(self) -> bool:
        """Whether anything tells the noise of the means."""
        return self.found.spare > 0 or bool(np.any(self.read.within > 0.0))

    @property
    def holds_drift(self) -> bool:
        """Whether a straight drift of the bias would count as scale factor, a twentieth of it at least."""
        free = TREND in self.design.left and not self.design.by_temperature and len(self.rate) > 2
        since = self.design.since
        return free and abs(float(self.weights[1] @ since)) * float(np.degrees(self.full_scale)) > 0.05

    @property
    def cubic_holds_drift(self) -> bool:
        """Whether a scale factor that drifts would count as a cubic part, a tenth of it at least."""
        powers = self.powers()
        drift = self.design.since * self.rate / float(np.degrees(self.full_scale))
        return len(powers) > 3 and abs(float(powers[3] @ drift)) > 0.1

    def effect(self, name: str) -> Ranged | None:
        """Of a column beside; `None` where the sequence does not tell it."""
        if name not in self.design.names:
            return None
        place = self.design.names.index(name)
        return self.of_draws(float(self.found.effects[place]), self.found.effect_draws[:, place])

    @cached_property
    def leaving(self) -> Float[np.ndarray, "n n"]:
        """What the response is multiplied with to be its deviation from the line."""
        line = np.column_stack([np.ones(len(self.rate)), self.rate]) @ self.weights
        return np.eye(len(self.rate)) - line

    @cached_property
    def by_level(self) -> Float[np.ndarray, "levels n"]:
        """What the response is multiplied with to be the mean deviation at each rate."""
        here = self.design.level == np.arange(self.design.level.max() + 1)[:, None]
        return (here / here.sum(axis=1, keepdims=True)) @ self.leaving

    def powers(self, *more: np.ndarray) -> Float[np.ndarray, "columns n"]:
        """What the response is multiplied with to be powers of rate over full scale, and `more`."""
        x = self.rate / float(np.degrees(self.full_scale))
        degree = min(3, int(self.design.level.max()))
        return np.linalg.pinv(np.column_stack([x**k for k in range(degree + 1)] + list(more)))
