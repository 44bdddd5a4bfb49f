"""Records that were taken in one place: a device that its surroundings move is another one in each of them."""

from collections.abc import Iterable
from typing import Any

import numpy as np

from .declared import Environment


NEAR = 1.0  # K, within which a temperature is the same


def away_from(around: Environment, temperature: np.ndarray, bias_voltage: np.ndarray, rate: np.ndarray) -> np.ndarray:
    """(n,) how far the surroundings of rows are from those declared, the bias before the temperature: zero within 1 K,
    infinite on a table that turns.
    """
    kelvins, volts = np.abs(temperature - around.temperature), np.abs(bias_voltage - around.bias_voltage)
    apart = np.where(kelvins < NEAR, 0.0, kelvins) + np.where(volts < 1e-6, 0.0, 1e3 * volts)
    return np.where(rate == 0, apart, np.inf)


def set_points(temperature: np.ndarray) -> np.ndarray:
    """(n,) number of the set point that each temperature [K] belongs to, from the coldest: those within 1 K of the
    coldest of them are one.
    """
    values, place = np.unique(temperature, return_inverse=True)
    numbers, first, number = np.zeros(values.size, int), -np.inf, -1
    for k, kelvins in enumerate(values):
        if kelvins >= first + NEAR:
            first, number = kelvins, number + 1
        numbers[k] = number
    return numbers[place.ravel()]


def with_place(records: Iterable[Any]) -> list[Any]:
    """Those of some records that tell in what surroundings they were taken."""
    return [r for r in records if hasattr(r, "away") and r.temperature is not None]


def in_one_place(around: Environment, records: Iterable[Any]) -> list[Any]:
    """The records without those that were taken farther from the surroundings declared than others of their axis, or
    than any where they drive none or both.
    """
    every = list(records)
    away = {id(r): float(np.min(r.away(around))) for r in with_place(every)}
    axes = {id(r): getattr(r, "axis", None) for r in with_place(every)}

    def is_near(record: Any) -> bool:
        axis = axes[id(record)]
        return away[id(record)] <= NEAR + min(far for one, far in away.items() if axis is None or axes[one] == axis)

    return [r for r in every if id(r) not in away or is_near(r)]


def in_another_place(around: Environment, record: Any, others: Iterable[Any]) -> bool:
    """Whether a record tells surroundings in which none of the others was taken; those that tell none were taken in
    those declared.
    """
    if not with_place([record]):
        return False
    kelvins, volts = float(np.mean(record.temperature)), float(np.mean(record.bias_voltage))
    taken = [
        (r.temperature, r.bias_voltage) if with_place([r]) else (around.temperature, around.bias_voltage)
        for r in others
    ]
    near = [(np.abs(warm - kelvins) <= NEAR) & (np.abs(bias - volts) < 1e-6) for warm, bias in taken]
    return not any(map(np.any, near))


def place_in_words(around: Environment, records: Iterable[Any]) -> str:
    """The surroundings at which a device's numbers hold, of those that records took at others, and whether any was
    taken there; empty where all were taken there.
    """
    every = with_place(records)
    if not every:
        return ""
    kelvins = np.concatenate([np.abs(r.temperature - around.temperature) for r in every])
    volts = np.concatenate([np.abs(r.bias_voltage - around.bias_voltage) for r in every])
    said = [f"{around.temperature - 273.15:.4g} °C"] * bool(np.any(kelvins >= NEAR))
    said += [f"{around.bias_voltage:.4g} V"] * bool(np.any(volts >= 1e-6))
    there = not said or any(np.any(r.away(around) == 0.0) for r in every)
    return " and ".join(said) + ("" if there else ", where no record was taken")


def nearest_in_words(around: Environment, records: Iterable[Any]) -> str:
    """The surroundings in which the records nearest to those declared were taken, of what varies; empty where nothing
    does.
    """
    every = with_place(records)
    if not every:
        return ""
    away, kelvins, volts = (
        np.concatenate(parts)
        for parts in zip(*((r.away(around), r.temperature, r.bias_voltage) for r in every), strict=True)
    )
    near = away <= away.min() + NEAR
    said = [f"{kelvins[near].mean() - 273.15:.4g} °C"] * bool(np.ptp(kelvins) > NEAR)
    said += [f"{volts[near][0]:.4g} V"] * bool(np.ptp(volts) > 1e-6)
    return " and ".join(said)
