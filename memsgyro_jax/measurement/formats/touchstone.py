"""Touchstone files of network analysers, s1p and s2p, through scikit-rf."""

import re
from pathlib import Path

import numpy as np

from memsgyro_jax.base.errors import InputError

from .base import Format, SourceColumn, SourceTable, library


class Touchstone(Format):
    """Scattering parameters over frequency, read as an admittance: the current that one volt makes."""

    name = "touchstone"

    def recognises(self, path: Path, head: bytes) -> bool:
        return re.fullmatch(r"\.(s\dp|ts)", path.suffix.lower()) is not None

    def read(self, path: Path) -> tuple[SourceTable, ...]:
        network = library("skrf", "scikit-rf", path).Network(str(path))
        if network.nports > 2:
            raise InputError(f"{path}: must have one port or two, but has {network.nports}; save the two of interest.")
        frequency = np.asarray(network.f)
        if len(frequency) < 3:
            raise InputError(f"{path}: must hold at least three frequencies, but holds {len(frequency)}.")
        through = network.nports == 2
        value = -network.y[:, 1, 0] if through else network.y[:, 0, 0]
        what = "-Y21, the current out of port 2" if through else "Y11, the current into the port"
        columns = (
            SourceColumn("frequency", "Hz", frequency),
            SourceColumn("Y real", "A", value.real),
            SourceColumn("Y imag", "A", value.imag),
            SourceColumn("drive", "V", np.ones(len(frequency))),
        )
        impedance = f"{float(np.real(network.z0[0, 0])):g} ohm"
        said = (f"the response is {what} under 1 V, from the scattering parameters at {impedance}",)
        return (SourceTable(path, "", columns, {"reads": "velocity"}, said),)
