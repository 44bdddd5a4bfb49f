"""Names and units along the dimensions of a Dataset, kept as its attributes: what a store is read by, without JAX."""

import json
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from .files import finite
from .units import without_roots


if TYPE_CHECKING:
    import xarray as xr

LABELS, UNITS_ALONG = "labels", "units"  # attributes that become coordinates: names, and units, along dimensions


def with_labels(data: "xr.Dataset") -> "xr.Dataset":
    """The Dataset with the names and units that its attributes hold as coordinates."""
    attributes, names = labels_apart(data.attrs)
    data = data.assign_coords(names)
    for name, variable in data.variables.items():
        variable.attrs.setdefault("long_name", str(name).replace("_", " "))
    data.attrs = plain_attributes(attributes)
    return data


def labels_apart(attributes: Mapping[str, Any]) -> tuple[dict[str, Any], dict[str, tuple[str, list[str]]]]:
    """The attributes without names and units along dimensions, and these as coordinates: dimension and texts."""
    rest = dict(attributes)
    labels, units = rest.pop(LABELS, {}), rest.pop(UNITS_ALONG, {})
    names = {name: (name, list(texts)) for name, texts in labels.items() if texts}
    along = {f"{name}_unit": (name, list(map(without_roots, each))) for name, each in units.items() if each}
    return rest, names | along


def plain_attributes(attributes: Mapping[str, Any]) -> dict[str, Any]:
    """Attributes that every format holds: numbers and text."""
    return {name: _plain(value) for name, value in attributes.items() if value is not None}


def _plain(value: Any) -> Any:
    if isinstance(value, bool | np.bool_):
        return int(value)
    if isinstance(value, str | float | np.floating):
        return value
    if isinstance(value, int | np.integer) and abs(int(value)) < 2**31:
        return value
    return json.dumps(finite(value), ensure_ascii=False, default=str)
