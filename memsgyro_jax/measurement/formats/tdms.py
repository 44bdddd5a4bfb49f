"""TDMS files of LabVIEW and other programs of National Instruments, through npTDMS."""

import logging
from collections import defaultdict
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from .base import Format, SourceColumn, SourceTable, library
from .header import split_header, tidy_unit


@contextmanager
def _unheard() -> Iterator[list[str]]:
    """What npTDMS has to say of a damaged file, kept from the terminal."""
    said: list[str] = []
    loggers = [logging.getLogger(name) for name in [*logging.root.manager.loggerDict] if name.startswith("nptdms")]

    def keep(record: logging.LogRecord) -> bool:
        said.append(record.getMessage())
        return False

    for logger in loggers:
        logger.addFilter(keep)
    try:
        yield said
    finally:
        for logger in loggers:
            logger.removeFilter(keep)


class Tdms(Format):
    """Channels of waveforms in groups: a table of each length and clock in a group."""

    name = "TDMS"

    def recognises(self, path: Path, head: bytes) -> bool:
        return head[:4] in (b"TDSm", b"TDSh")

    def read(self, path: Path) -> tuple[SourceTable, ...]:
        reader = library("nptdms", "npTDMS", path).TdmsFile
        with _unheard() as heard:
            file = reader.read(path)
        assumed = ("the file is damaged or broke off, and is read as far as it goes",) if heard else ()
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
                tables.append(SourceTable(path, name, tuple(columns), words, assumed))
        return tuple(tables)
