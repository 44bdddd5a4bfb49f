"""The device and the read-out of the default study, those of the thesis."""

from memsgyro_jax.loop.readout import THESIS_RATE, snr_density

from .masses import SingleMass
from .pickoffs import Charge


DENSITY = f"{snr_density(100.0, 1e-6, 1e5, THESIS_RATE)!r} V/sqrt(Hz)"


def thesis_device() -> SingleMass:
    """Thesis Table 5.1."""
    return SingleMass(
        kind="single_mass", mass="1.8e-7 kg", kxx="63.96 N/m", kyy="95.92 N/m", kxy="12.78 N/m",
        dxx="3.6e-6 N*s/m", dyy="4.5e-6 N*s/m", dxy="3.6e-7 N*s/m",
    )  # fmt: skip


def thesis_readout() -> Charge:
    """Thesis Table 5.3, with the noise density of 1 mV per sample at 10 MHz."""
    return Charge(
        kind="charge_amplifier", fingers=113, width="5e-6 m", gap="1e-6 m", overlap="50e-6 m",
        mismatch=["0.1e-6 m", "0.085e-6 m"], bias="10 V", feedback="1e-12 F", parasitic="1e-12 F",
        opamp_offset=["2e-3 V", "1e-3 V"],
        noise_density=DENSITY,
    )  # fmt: skip
