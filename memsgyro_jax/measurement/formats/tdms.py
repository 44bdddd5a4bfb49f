"""TDMS files of LabVIEW and other programs of National Instruments, through npTDMS."""

from collections import defaultdict
from pathlib import Path

import numpy as np

from .base import Format, SourceColumn, SourceTable, library
from .header import split_header, tidy_unit


class Tdms(Format):
    """Channels of waveforms in groups: a table of each length and clock in a group."""

    name = "TDMS"

    def recognises(self, path: Path, head: bytes) -> bool:
        return head[:4] in (b"TDSm", b"TDSh")

    def read(self, path: Path) -> tuple[SourceTable, ...]:
        file = library("nptdms", "npTDMS", path).TdmsFile.read(path)
        tables = []
        for group in file.groups():
            alike = defaultdict(list)
            for channel in group.channels():
                if len(channel) > 1 and np.asarray(channel[:]).dtype.kind in "iufc":
                    step = float(channel.properties.get("wf_increment", 0.0) or 0.0)
                    alike[len(channel), step].append(channel)
            for (rows, step), channels in alike.items():
                columns, words = [], {k: str(v) for k, v in {**file.properties, **group.properties}.items()}
                if step and not any(channel.name.lower() in ("time", "t") for channel in channels):
                    begin = float(channels[0].properties.get("wf_start_offset", 0.0) or 0.0)
                    columns.append(SourceColumn("time", "s", begin + step * np.arange(rows)))
                for channel in channels:
                    name, unit = split_header(channel.name)
                    said = channel.properties.get("unit_string") or channel.properties.get("NI_UnitDescription") or ""
                    columns.append(SourceColumn(name, tidy_unit(str(said)) or unit, np.asarray(channel[:])))
                name = group.name if len(file.groups()) > 1 else ""
                tables.append(SourceTable(path, name, tuple(columns), words))
        return tuple(tables)
