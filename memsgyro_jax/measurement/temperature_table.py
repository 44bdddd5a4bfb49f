"""A compensation table: offset and scale of a gyro over temperature, fitted on one ramp, right on the next one."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from memsgyro_jax.base.axes import axes
from memsgyro_jax.base.concrete import is_concrete
from memsgyro_jax.base.display import Displayed
from memsgyro_jax.base.errors import InputError


if TYPE_CHECKING:
    from matplotlib.axes import Axes


_POOR = 1e-8  # least singular value over the greatest of what still tells every entry
_CELSIUS = 273.15


class TemperatureTable(Displayed):
    """Output = offset(T) + scale(T) · rate, both linear between `temperatures` [K], beyond which their ends hold:
    `offset` in rad/s, `scale` a pure number. Make one with `fit`.
    """

    temperatures: Float[Array, " knots"] = eqx.field(converter=jnp.asarray, metadata={"unit": "K"})
    offset: Float[Array, " knots"] = eqx.field(converter=jnp.asarray, metadata={"unit": "rad/s"})
    scale: Float[Array, " knots"] = eqx.field(converter=jnp.asarray, metadata={"unit": "1"})

    def __check_init__(self):
        if is_concrete(self.temperatures):
            _check_rising(np.asarray(self.temperatures))

    @classmethod
    def fit(
        cls,
        temperature: Float[np.ndarray, " samples"],
        output: Float[np.ndarray, " samples"],
        rate: Float[np.ndarray, " samples"],
        knots: Sequence[float] | int = 9,
    ) -> "TemperatureTable":
        """By least squares from an `output` [rad/s] at a known `rate` [rad/s] along a ramp of `temperature` [K].

        `knots` are the temperatures of the table, or how many, evenly from the least to the greatest. The rate must
        change beside every one of them, or offset and scale cannot be told apart.

        **Raises:** `InputError` where they cannot, for unequal lengths, and for what is not finite.
        """
        columns = [np.asarray(part, float).ravel() for part in (temperature, output, rate)]
        if len({part.size for part in columns}) > 1 or not all(np.isfinite(part).all() for part in columns):
            raise InputError(
                "Arguments `temperature`, `output` and `rate` must be equally many finite numbers, but are "
                f"{', '.join(str(int(np.isfinite(part).sum())) for part in columns)} finite of "
                f"{', '.join(str(part.size) for part in columns)}."
            )
        warm, given, turning = columns
        places = np.linspace(warm.min(), warm.max(), knots) if isinstance(knots, int) else np.asarray(knots, float)
        _check_rising(places)
        hats = np.stack([np.interp(warm, places, unit) for unit in np.eye(len(places))], axis=1)
        largest = max(float(np.max(np.abs(turning))), 1e-300)
        matrix = np.concatenate([hats, hats * (turning / largest)[:, None]], axis=1)
        size = np.linalg.svd(matrix, compute_uv=False)
        if len(size) < matrix.shape[1] or size[-1] < _POOR * size[0]:
            raise InputError(
                f"The rate must change, and the temperature dwell, beside every one of the {len(places)} temperatures "
                "of the table, but some of its entries cannot be told; take fewer, or turn the table more often."
            )
        offset, scale = np.split(np.linalg.lstsq(matrix, given)[0], 2)
        return cls(places, offset, scale / largest)

    def corrected(self, output: Array, temperature: Array) -> Array:
        """The rate [rad/s] that stands behind an output [rad/s] at a temperature [K]."""
        offset, scale = (jnp.interp(temperature, self.temperatures, part) for part in (self.offset, self.scale))
        return (output - offset) / scale

    def plot(self, ax: "Axes | None" = None) -> "Axes":
        """Offset over temperature; the scale, less one, in percent against the other side."""
        ax = axes(ax)
        celsius = np.asarray(self.temperatures) - _CELSIUS
        ax.plot(celsius, np.degrees(self.offset), "o-", label="offset")
        ax.set(xlabel="temperature [°C]", ylabel="offset [deg/s]")
        beside = ax.twinx()
        beside.plot(celsius, 100.0 * (np.asarray(self.scale) - 1.0), "s--", color="tab:orange", label="scale")
        beside.set_ylabel("scale less one [%]")
        return ax


def _check_rising(places: np.ndarray) -> None:
    if places.ndim != 1 or len(places) < 2 or not np.all(np.diff(places) > 0.0):
        raise InputError(
            "The temperatures of a table must be two or more, and rise, but are "
            f"{np.array2string(places, threshold=6)}."
        )
