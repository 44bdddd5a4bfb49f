"""Universal file format, dataset 58 (functions at nodal degrees of freedom), through pyuff."""

from collections import defaultdict
from pathlib import Path

import numpy as np

from memsgyro_jax.base.errors import InputError

from .base import Format, SourceColumn, SourceTable, complex_columns, library
from .header import tidy_unit


_ABSCISSA = {17: ("time", "s"), 18: ("frequency", "Hz")}
_QUANTITIES = {8: ("displacement", "m"), 9: ("force", "N"), 11: ("velocity", "m/s"), 12: ("acceleration", "m/s^2"),
               13: ("force", "N")}  # fmt: skip
_AMPLITUDES = (0, 1, 4, 12)  # kinds of functions: general, time response, frequency response, spectrum


class Universal(Format):
    """Functions over time or frequency; those with one abscissa are one table."""

    name = "universal file"

    def recognises(self, path: Path, head: bytes) -> bool:
        return head.replace(b"\r", b"").lstrip(b"\n").startswith(b"    -1\n")

    def read(self, path: Path) -> tuple[SourceTable, ...]:
        sets = library("pyuff", "pyuff", path).UFF(str(path)).read_sets()
        functions = [one for one in (sets if isinstance(sets, list) else [sets]) if one.get("type") == 58]
        functions = [one for one in functions if int(one.get("func_type", 0)) in _AMPLITUDES]
        alike = defaultdict(list)
        for one in functions:
            alike[np.asarray(one["x"]).tobytes(), one.get("abscissa_spec_data_type")].append(one)
        tables = [_table(path, group, len(alike) > 1) for group in alike.values()]
        if not tables:
            raise InputError(
                f"{path}: must hold a time or frequency response or a spectrum (dataset 58), but holds none."
            )
        return tuple(tables)


def _table(path: Path, group: list[dict], several: bool) -> SourceTable:
    first = group[0]
    name, unit = _ABSCISSA.get(int(first.get("abscissa_spec_data_type", 0)), ("abscissa", ""))
    columns = [
        SourceColumn(name, tidy_unit(str(first.get("abscissa_axis_units_lab", ""))) or unit, np.asarray(first["x"]))
    ]
    assumed = []
    for one in group:
        what, usual = _QUANTITIES.get(int(one.get("ordinate_spec_data_type", 0)), ("response", ""))
        label = str(one.get("ordinate_axis_units_lab", "")).strip()
        unit = tidy_unit(label) or usual
        if what != "response" and not tidy_unit(label):
            assumed.append(f"{what} is in {usual}, the unit of universal files in SI")
        node = f" {one['rsp_node']}.{one['rsp_dir']}" if len(group) > 1 and "rsp_node" in one else ""
        columns += complex_columns(f"{what}{node}", unit, np.asarray(one["data"]))
    about = {key: str(first.get(key, "")) for key in ("id1", "id2", "id3")}
    reads = {_QUANTITIES.get(int(one.get("ordinate_spec_data_type", 0)), ("",))[0] for one in group} & {
        "displacement", "velocity", "acceleration",
    }  # fmt: skip
    about |= {"reads": next(iter(reads))} if len(reads) == 1 else {}
    per_force = int(first.get("func_type", 0)) == 4
    if per_force:
        columns.append(SourceColumn("force", "N", np.ones(len(columns[0].values))))
        assumed.append("a frequency response is the response to 1 N")
    return SourceTable(path, str(first.get("id1", "")) if several else "", tuple(columns), about, tuple(assumed))
