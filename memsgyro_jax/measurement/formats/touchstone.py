"""Touchstone files of network analysers, s1p and s2p, through scikit-rf."""

import re
from pathlib import Path
from typing import Any

import numpy as np

from memsgyro_jax.base.errors import InputError

from .base import Format, SourceColumn, SourceTable, library


class Touchstone(Format):
    """Scattering parameters over frequency: what the load sees of one volt, a ratio to the drive.

    A resonance is one in every scattering parameter too, with the quality factor that the ports leave it. Unlike an
    admittance worked out from it, it keeps its noise as the analyser had it, the same at all frequencies.
    """

    name = "touchstone"

    def recognises(self, path: Path, head: bytes) -> bool:
        return re.fullmatch(r"\.(s\dp|ts)", path.suffix.lower()) is not None

    def read(self, path: Path) -> tuple[SourceTable, ...]:
        skrf = library("skrf", "scikit-rf", path)
        network = skrf.Network(str(path))
        if network.nports > 2:
            raise InputError(f"{path}: must have one port or two, but has {network.nports}; save the two of interest.")
        frequency = np.asarray(network.f)
        if len(frequency) < 3:
            raise InputError(f"{path}: must hold at least three frequencies, but holds {len(frequency)}.")
        through, scattering = network.nports == 2, _scattering(skrf, network, path)
        value = scattering[:, 1, 0] if through else 1.0 - scattering[:, 0, 0]
        columns = (
            SourceColumn("frequency", "Hz", frequency),
            SourceColumn("S real", "V", value.real),
            SourceColumn("S imag", "V", value.imag),
            SourceColumn("drive", "V", np.ones(len(frequency))),
        )
        what, ohms = "S21" if through else "1 - S11", float(np.real(network.z0[0, 0]))
        said = f"the response is {what}, a ratio to the drive, as of the current through a resonator in series"
        loaded = f"its quality factor is the one beside the ports' {ohms:g} ohm"
        return (SourceTable(path, "", columns, {"reads": "velocity", "ratio": "drive"}, (said, loaded)),)


def _scattering(skrf: Any, network: Any, path: Path) -> np.ndarray:
    """The scattering parameters (n, ports, ports). Files of version 1 hold admittances times the resistance of the
    ports (Touchstone File Format Specification 1.1), where the library takes them for admittances over it.
    """
    file, ohms = skrf.io.touchstone.Touchstone(str(path)), network.z0
    if file.parameter != "y" or str(file.version) != "1.0":
        return np.asarray(network.s)
    held = skrf.network.s2y(network.s, ohms) / ohms[:, :, None]
    return np.asarray(skrf.network.y2s(held / ohms[:, :, None], ohms))
