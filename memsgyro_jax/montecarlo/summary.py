"""The figures of a lot that a person and a script want: percentiles, yield, ratio to the bound."""

from dataclasses import asdict, astuple, dataclass

import numpy as np

from memsgyro_jax.base.display import Shown
from memsgyro_jax.base.files import finite
from memsgyro_jax.base.provenance import Settings
from memsgyro_jax.base.text import aligned
from memsgyro_jax.loop.loop import ClosedLoop
from memsgyro_jax.loop.observers import AbstractCovarianceObserver

from .batch import LOST, OK, STATUS, Plan
from .merit import (
    Following,
    Percentiles,
    Proportion,
    StraightError,
    following,
    percentiles,
    proportion,
    straight_error,
)


SCHEMA = "memsgyro-sweep/1"


@dataclass(frozen=True)
class Summary(Shown):
    """Figures of a lot, in SI; `as_dict` gives the machine-readable form with its units in the names.

    `end` and `settled` are over the dies that were not lost; `bound` is the root mean square over dies of the least
    standard deviation any unbiased use of the same data and prior could reach at the end, None where it does not apply.
    `nees` is the mean over dies, `states` its expectation; `straight` holds bias and scale-factor error. `steps_per_s`
    is None when a single batch left nothing to time after compiling.
    """

    dies: int
    failed: int
    end: Percentiles
    settled: Percentiles
    series_std: float
    bound: float | None
    ratio_to_bound: float | None
    nees: float | None
    states: int | None
    nis: float | None
    convergence_time: float | None
    good: Proportion
    following: Following | None
    straight: StraightError | None
    steps_per_s: float | None
    settings: Settings

    def as_dict(self) -> dict[str, object]:
        """The content of `summary.json`."""
        degrees = lambda p: {name: float(np.degrees(value)) for name, value in asdict(p).items()}  # noqa: E731
        entries = {
            "schema": SCHEMA,
            "dies": self.dies,
            "failed": self.failed,
            "rate_error_dps": {"end": degrees(self.end), "settled": degrees(self.settled)},
            "rate_series_std_dps": float(np.degrees(self.series_std)),
            "bound_dps": None if self.bound is None else float(np.degrees(self.bound)),
            "ratio_to_bound": self.ratio_to_bound,
            "nees": self.nees,
            "nees_expected": self.states,
            "nis": self.nis,
            "convergence_time_s": self.convergence_time,
            "yield": asdict(self.good),
            "following": None if self.following is None else _following(self.following),
            **({} if self.straight is None else _straight(self.straight)),
            "steps_per_s": self.steps_per_s,
            "seed": self.settings.seed,
            "sample_rate_hz": self.settings.sample_rate,
            "duration_s": self.settings.duration,
            "fingerprint": self.settings.fingerprint,
            "versions": dict(self.settings.versions),
        }
        return finite(entries)

    def rows(self) -> list[tuple[str, str]]:
        """Name and value as text, for a table."""
        end, settled = (tuple(np.degrees([p.rms, p.p50, p.p95])) for p in (self.end, self.settled))
        rows = [
            ("dies", f"{self.dies}, of which {self.failed} lost"),
            ("rate error at the end (rms, median, 95 %)", "{:.3g}, {:.3g}, {:.3g} deg/s".format(*end)),
            ("rate error over the settled part", "{:.3g}, {:.3g}, {:.3g} deg/s".format(*settled)),
            ("standard deviation within one run", f"{np.degrees(self.series_std):.3g} deg/s"),
        ]
        if self.bound is not None and self.ratio_to_bound is not None:
            text = f"{np.degrees(self.bound):.3g} deg/s (reached x {self.ratio_to_bound:.3g})"
            rows.append(("information bound at the end", text))
        if self.nees is not None:
            rows.append(("consistency (NEES, NIS)", f"{self.nees:.3g} of {self.states}, {self.nis:.3g} of 2"))
        if self.convergence_time is not None:
            rows.append(("median time to converge", f"{1e3 * self.convergence_time:.3g} ms"))
        share = "{:.1f} % ({:.1f} to {:.1f} %)".format(*(100.0 * v for v in astuple(self.good)[:3]))
        rows.append(("yield (95 % interval)", f"{share}: {self.good.criterion}"))
        if self.straight is not None:
            rows.append(("bias, scale-factor error", _straight_text(self.straight)))
        if self.following is not None:
            rows.append(("varying rate followed", _following_text(self.following)))
        if self.steps_per_s is not None:
            rows.append(("speed after compiling", f"{self.steps_per_s / 1e6:.3g} million steps/s"))
        return rows

    def __repr__(self) -> str:
        return aligned(self.rows())


def summarise(
    rows: dict[str, np.ndarray],
    plan: Plan,
    settings: Settings,
    loop: ClosedLoop,
    bound: float | None,
    speed: float | None,
) -> Summary:
    """Figures over the dies of `rows` that were computed; lost dies count as failed and never as numbers."""
    status = rows[STATUS]
    alive = status == OK
    end = rows["rate_error_end"][alive]
    good = int(np.sum(np.abs(end) <= plan.tolerance))
    computed = int(np.sum(alive | (status == LOST)))
    figures = percentiles(end)
    nees, nis = (_mean(rows[name][alive]) for name in ("nees_end", "nis_mean"))
    settled = plan.window_times >= plan.settle
    if alive.any():
        true = np.mean(rows["rate_true"][alive][:, settled], axis=1)
        straight = straight_error(true, np.mean(rows["rate_estimate"][alive][:, settled], axis=1) - true)
    else:
        straight = None
    return Summary(
        dies=computed,
        failed=int(np.sum(status == LOST)),
        end=figures,
        settled=percentiles(rows["rate_error_rms"][alive]),
        series_std=percentiles(rows["rate_series_std"][alive]).rms,
        bound=bound,
        ratio_to_bound=None if bound is None or not alive.any() else figures.rms / bound,
        nees=nees,
        states=None if nees is None else _states(loop),
        nis=nis,
        convergence_time=_median(rows["convergence_time"][alive]),
        good=proportion(good, computed, f"rate error at the end within {np.degrees(plan.tolerance):.3g} deg/s"),
        following=following(
            plan.window_times[settled],
            rows["rate_true"][alive][:, settled] if alive.any() else np.zeros(int(settled.sum())),
            rows["rate_estimate"][alive][:, settled],
        ),
        straight=straight,
        steps_per_s=speed,
        settings=settings,
    )


def _states(loop: ClosedLoop) -> int:
    assert isinstance(loop.observer, AbstractCovarianceObserver)  # no other observer gives a NEES
    return len(loop.observer.states)


def _mean(values: np.ndarray) -> float | None:
    finite = values[np.isfinite(values)]
    return float(np.mean(finite)) if finite.size else None


def _median(values: np.ndarray) -> float | None:
    """Median with never-converged dies as infinitely late; None when that is the median, or without dies."""
    late = np.where(np.isfinite(values), values, np.inf)
    middle = float(np.median(late)) if late.size else np.inf
    return middle if np.isfinite(middle) else None


def _following(result: Following) -> dict[str, float | None]:
    return {"rms_dps": float(np.degrees(result.rms)), "delay_s": result.delay, "bandwidth_hz": result.bandwidth}


def _following_text(result: Following) -> str:
    band = "beyond what the record shows" if result.bandwidth is None else f"{result.bandwidth:.3g} Hz"
    return f"rms {np.degrees(result.rms):.3g} deg/s, delay {1e3 * result.delay:.3g} ms, bandwidth {band}"


def _straight(error: StraightError) -> dict[str, object]:
    bias = {"value": float(np.degrees(error.bias)), "std": float(np.degrees(error.bias_std))}
    return {"bias_dps": bias, "scale_factor_error": {"value": error.scale, "std": error.scale_std}}


def _straight_text(error: StraightError) -> str:
    bias = f"{np.degrees(error.bias):.3g} ± {np.degrees(error.bias_std):.2g} deg/s"
    if error.scale is None or error.scale_std is None:
        return f"{bias}, unknown (all dies turn alike)"
    return f"{bias}, {100.0 * error.scale:.3g} ± {100.0 * error.scale_std:.2g} %"
