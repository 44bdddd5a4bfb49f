"""A fitted case as labelled arrays: every reading beside its prediction, the errors, the parameters."""

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from memsgyro_jax.base.labelled import columns_of, labelled
from memsgyro_jax.measurement.case import Case


if TYPE_CHECKING:
    import xarray as xr


def fit_table(fit: Any) -> "xr.Dataset":
    """The Dataset of a fit; phasors have two readings each, I and Q."""
    readings, settings = readings_table(fit.case, {"": fit})
    variables = {**readings, **errors_table({"": fit}), **parameters_table(fit)}
    about = {"case": fit.case.name, "status": fit.status, "chi2_per_dof": fit.chi2_per_dof}
    return labelled(fit, variables, settings, about | {"effects": [e.label for e in fit.model.present.effects]})


def readings_table(case: Case, fits: dict[str, Any]) -> tuple[dict[str, tuple], dict[str, tuple]]:
    """Variables and coordinates over `reading`; the names of what a fit gives end in its key."""
    unit, parts = case.readout.unit, [_columns(case, number, fits) for number in range(len(case.records))]
    units = {name: unit for part in parts for name, unit in part.units.items()}
    units |= {"measured": unit, "noise": unit} | {f"predicted{key}": unit for key in fits}
    units |= {f"whitened{key}": "1" for key in fits}
    joined = {}
    for name in dict.fromkeys(name for part in parts for name in part.columns):
        pieces = [part.columns.get(name, np.full(part.size, np.nan)) for part in parts]
        joined[name] = ("reading", np.concatenate(pieces), units.get(name))
    values = {"measured", "noise", "fitted", *(f"{name}{key}" for name in ("predicted", "whitened") for key in fits)}
    return {n: v for n, v in joined.items() if n in values}, {n: v for n, v in joined.items() if n not in values}


def errors_table(fits: dict[str, Any]) -> dict[str, tuple]:
    """Errors of each record and role over `entry`."""
    entries = next(iter(fits.values())).errors
    out: dict[str, tuple] = {
        f"entry_{name}": ("entry", [getattr(e, name) for e in entries], None) for name in ("name", "role")
    }
    out["readings"] = ("entry", [e.count for e in entries], "1", "number of readings")
    for key, fit in fits.items():
        out[f"rms{key}"] = ("entry", [e.rms for e in fit.errors], "1", "rms of the deviation over the noise")
        out[f"explained{key}"] = ("entry", [e.explained for e in fit.errors], "1", "whether noise alone explains it")
    return out | {"gate": ("entry", [e.gate for e in entries], "1", "χ²/N up to which noise alone explains a record")}


def parameters_table(fit: Any, *, with_std: bool = True) -> dict[str, tuple]:
    """Estimates over `parameter`; NaN in place of standard deviations that are not told."""
    told = fit.estimates if with_std else [replace(estimate, std=np.nan) for estimate in fit.estimates]
    held = columns_of("parameter", told, name=None, value=None, std=None, unit=None)
    return {"parameter" if name == "name" else f"parameter_{name}": column for name, column in held.items()}


def effects_table(found: Any) -> dict[str, tuple]:
    """Accepted effects and terms of the instrument over `effect`, a row for each component of a strength."""
    every = [(a, k) for a in (*found.accepted, *found.instrument) for k in range(len(a.estimate))]
    parts = [f"{a.label}[{k}]" if len(a.estimate) > 1 else a.label for a, k in every]
    out = columns_of("effect", [a for a, _ in every], p_value="1", error_before="1", error_after="1")
    return {f"effect_{name}": held for name, held in out.items()} | {
        "effect": ("effect", parts, None),
        "estimate": ("effect", [a.estimate[k] for a, k in every], None, "strength"),
        "estimate_std": ("effect", [a.std[k] for a, k in every], None, "standard deviation of the strength"),
        "effect_unit": ("effect", [a.unit for a, _ in every], None),
        "of_instrument": ("effect", [a in found.instrument for a, _ in every], "1", "whether it is the instrument's"),
    }


class _Columns:
    """Columns of a record, one entry for each real reading."""

    def __init__(self, size: int):
        self.size, self.columns, self.units = size, dict[str, np.ndarray](), dict[str, str]()


def _columns(case: Case, number: int, fits: dict[str, Any]) -> _Columns:
    record = case.records[number]
    shape = next(iter(fits.values())).whitened[number].shape
    out = _Columns(int(np.prod(shape)))
    axis = lambda labels, place: np.broadcast_to(  # noqa: E731
        np.reshape(labels, [-1 if k == place else 1 for k in range(3)]), shape
    ).ravel()
    split = lambda values: (  # noqa: E731
        np.stack([values.real, values.imag], axis=-1) if shape[-1] == 2 else values[..., None]
    ).ravel()
    out.columns = {
        "record": np.full(out.size, record.name),
        "kind": np.full(out.size, record.kind),
        "row": axis(np.arange(shape[0]), 0),
        "channel": axis(["x", "y"][: shape[1]], 1),
        "part": axis(["I", "Q"] if shape[-1] == 2 else ["signal"], 2),
        "measured": split(record.readings),
        "noise": np.repeat(record.noise_of_rows.ravel(), shape[-1]),
        "fitted": axis(next(iter(fits.values())).fitted[number], 0),
    }
    for key, fit in fits.items():
        out.columns[f"predicted{key}"] = split(fit.predicted(number))
        out.columns[f"whitened{key}"] = fit.whitened[number].ravel()
    for known in record.known(case):
        name = known.name.replace(" ", "_")
        out.columns[name], out.units[name] = axis(known.values, 0), known.unit
    return out
