"""The conditions under which rows are simulated side by side: one value per row in every array, rows last."""

from dataclasses import dataclass, fields
from functools import cached_property

import numpy as np
from numpy.polynomial import chebyshev


@dataclass(frozen=True)
class Rows:
    """True conditions.

    The commanded force is a Chebyshev series `held` over [origin, origin + span] plus swing cos(w t + chirp t²/2).
    """

    stiffness: np.ndarray  # (3, rows) kxx, kyy, kxy
    damping: np.ndarray  # (3, rows) dxx, dyy, dxy
    rate: np.ndarray  # (rows,)
    turn: np.ndarray  # (rows,) angular acceleration
    held: np.ndarray  # (terms, 2, rows)
    origin: np.ndarray
    span: np.ndarray
    swing: np.ndarray  # (2, rows)
    frequency: np.ndarray  # (rows,) rad/s
    chirp: np.ndarray  # (rows,) rad/s²
    volts_squared: np.ndarray  # (rows,) of the bias
    step_time: np.ndarray  # (rows,) when the damping steps; infinite where it never does

    def __len__(self):
        return len(self.rate)

    def take(self, index):
        """These rows alone, in this order."""
        return Rows(*(getattr(self, f.name)[..., index] for f in fields(self)))

    @cached_property
    def _chirped(self):
        return bool(np.any(self.chirp))

    @cached_property
    def swinging(self):
        """Whether any row is driven by a swing."""
        return bool(np.any(self.swing))

    def phase(self, t):
        return self.frequency * t + 0.5 * self.chirp * t**2 if self._chirped else self.frequency * t

    def command(self, t):
        """Commanded force (2, rows) [N]."""
        force = self.swing * np.cos(self.phase(t)) if self.swinging else np.zeros_like(self.swing)
        if len(self.held) == 1:
            return force + self.held[0]
        return force + chebyshev.chebval(2 * (t - self.origin) / self.span - 1, self.held, tensor=False)


def rows(die, hidden, count, temperature=0.0, bias=0.0, rate=0.0, turn=0.0, calibrated=False, pull=0.0,
         reference=10.0, **drive):  # fmt: skip
    """Conditions of `count` rows. `temperature` is T - T_ref [K], `bias` is V² - V_ref² [V²] with V_ref the `reference`
    [V], `pull` what all resonances change by, relative.
    """
    wide = np.ones(count)
    softening = np.append(hidden.pair("electrostatic_softening"), 0.0)[:, None] * (bias * wide)
    heat = np.array([1.0, 1.0, float(hidden.thermal_drift_couplings)])[:, None] * temperature * wide
    bent = (hidden.thermal_curvature_stiffness, hidden.thermal_curvature_damping)  # all of it on the axes' own
    square = np.array([1.0, 1.0, 0.0])[:, None] * temperature**2 * wide
    stiffness = die.stiffness[:, None] * (1 + hidden.thermal_drift_stiffness * heat + bent[0] * square) - softening
    stiffness = stiffness * (1 + pull * wide) ** 2
    damping = die.damping[:, None] * (1 + hidden.thermal_drift_damping * heat + bent[1] * square)
    scale = 1 + hidden.rate_scale_error
    true_rate = scale * rate * wide + (0.0 if calibrated else hidden.rate_offset)
    zero = np.zeros(count)
    default = {
        "held": np.zeros((1, 2, count)), "origin": zero, "span": wide, "swing": np.zeros((2, count)),
        "frequency": zero, "chirp": zero, "step_time": np.full(count, np.inf),
        "volts_squared": reference**2 + bias * wide,
    }  # fmt: skip
    return Rows(stiffness, damping, true_rate, scale * turn * wide, **(default | drive))
