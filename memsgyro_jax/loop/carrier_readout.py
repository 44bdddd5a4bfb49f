"""A capacitive pick-off that a carrier reads, as its equivalent in the base band."""

import equinox as eqx
import jax.numpy as jnp

from memsgyro_jax.base.concrete import check_positive
from memsgyro_jax.base.errors import InputError
from memsgyro_jax.device.brownian import BOLTZMANN
from memsgyro_jax.device.electronics import CarrierDetection
from memsgyro_jax.device.gyro import Pair, Scalar, X, Y, number

from .flicker import Flicker
from .pairs import pair_field
from .readout import AbstractLinearReadout, Adc


class CarrierReadout(AbstractLinearReadout):
    """The `detection` (one for both axes, or a pair) of a sensor each half of which changes by `gradient` [F/m].

    `mismatch` [F] is by how much the halves differ at rest. The volts are what the carrier leaves of a motion at
    `frequency` [Hz], in amplitude and phase: of a displacement Re(x e^{jωt}) they are 2·`gradient`·Re(G(ω) x e^{jωt}),
    with G of `CarrierDetection.response`; a motion at another frequency is delayed as that at `frequency` is. The
    offset of the op-amp stays at the carrier. The noise is that at `frequency`, as if white; `sampler` [F] adds k T/C
    at `sample_rate` [Hz], by the temperature of the stage, infinite is none.
    """

    detection: tuple[CarrierDetection, CarrierDetection] = eqx.field(
        converter=lambda given: tuple(given) if isinstance(given, tuple | list) else (given, given)
    )
    gradient: Scalar | Pair = pair_field("F/m")
    frequency: Scalar = number("Hz")
    mismatch: Scalar | Pair = pair_field("F", default=0.0)
    sampler: Scalar = number("F", default=jnp.inf)
    sample_rate: Scalar = number("Hz", default=jnp.inf)
    adc: Adc | None = None
    signals: tuple[int, int] = eqx.field(static=True, default=(X, Y))
    flicker: Flicker | None = None

    def __check_init__(self):
        if len(self.detection) != 2:
            raise InputError(f"Argument `detection` must be one or a pair, but {len(self.detection)} were given.")
        for value in self.gradient:
            check_positive("gradient", value)
        check_positive("frequency", self.frequency)

    @property
    def response(self) -> Pair:
        """Complex volts per displacement [V/m] at `frequency`."""
        omega = 2.0 * jnp.pi * self.frequency
        return tuple(2.0 * g * made.response(omega) for g, made in zip(self.gradient, self.detection, strict=True))

    @property
    def scale(self) -> Pair:
        """What is in phase with the displacement."""
        return tuple(jnp.real(found) for found in self.response)

    @property
    def offset(self) -> Pair:
        """Of the mismatch."""
        return tuple(
            jnp.real(made.response(jnp.zeros(()))) * missed
            for made, missed in zip(self.detection, self.mismatch, strict=True)
        )

    @property
    def noise_density(self) -> Pair:
        """Of all sources but the converter."""
        return tuple(jnp.sqrt(sum(powers.values())) for powers in self._powers(self.frequency))

    def noise_at(self, frequency: Scalar, period: Scalar) -> dict[str, Pair]:
        """By source."""
        first, second = self._powers(frequency)
        found: dict[str, Pair] = {name: (jnp.sqrt(first[name]), jnp.sqrt(second[name])) for name in first}
        return {**found, **{name: d for name, d in super().noise_at(frequency, period).items() if name == "converter"}}

    def clean(self, motion: tuple[Scalar, ...], drift: Pair) -> Pair:
        """What is in phase with the displacement, and what with the velocity."""
        omega = 2.0 * jnp.pi * self.frequency
        parts = zip(motion[:2], motion[2:], self.response, self.offset, drift, strict=False)
        return tuple(jnp.real(g) * q + jnp.imag(g) / omega * v + o + d for q, v, g, o, d in parts)

    def _powers(self, frequency: Scalar) -> tuple[dict[str, Scalar], ...]:
        omega = 2.0 * jnp.pi * frequency
        return tuple(
            {
                **made.powers(omega),
                "sampling (kT/C)": 2.0 * BOLTZMANN * made.stage.temperature / (self.sampler * self.sample_rate),
            }
            for made in self.detection
        )
