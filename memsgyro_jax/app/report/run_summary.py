"""The figures of one run, for people and for machines."""

from typing import Any

import numpy as np

from memsgyro_jax.base.files import finite
from memsgyro_jax.loop.trace_result import Trace


SCHEMA = "memsgyro-run/1"


def run_figures(trace: Trace, settle: float | None) -> dict[str, Any]:
    """What `summary.json` of a run holds; not-a-number (a lost die, an observer without covariance) is None."""
    given = trace.settings
    begin = 0.5 * given.duration if settle is None else settle
    entries = {
        "schema": SCHEMA,
        "status": trace.status,
        "lost_at_s": trace.lost_at,
        "rate_error_dps": _error(trace.rate_error, trace.time >= begin),
        "rate_error_before_filter_dps": _error(trace.rate_unfiltered - trace.rate_true, trace.time >= begin)
        if trace.filtered
        else None,
        "claimed_std_end_dps": float(np.degrees(trace.rate_std[-1])),
        "nis_mean": float(np.average(trace.nis, weights=np.diff(trace.time, prepend=0.0))),  # over time: blocks grow
        "coefficient_error": {
            name: float(trace.theta_estimate[-1, i] / trace.theta[i] - 1.0)
            for i, name in enumerate(trace.coefficients)
            if not name.startswith("rate")
            and trace.readings is None
            and trace.loop.observer.learns  # or there is no estimate
        },
        "settled_from_s": begin,
        "sample_rate_hz": given.sample_rate,
        "duration_s": given.duration,
        "seed": given.seed,
        "fingerprint": given.fingerprint,
        "versions": dict(given.versions),
    }
    return finite(entries)


def _error(error: np.ndarray, settled: np.ndarray) -> dict[str, float]:
    """End, and root mean square, mean and standard deviation over the settled samples, in deg/s."""
    end = float(np.degrees(error[-1]))
    chosen = np.degrees(error[settled] if settled.any() else error[-1:])
    rms = float(np.sqrt(np.mean(chosen**2)))
    return {"end": end, "rms": rms, "mean": float(np.mean(chosen)), "std": float(np.std(chosen))}


def run_rows(figures: dict[str, Any]) -> list[tuple[str, str]]:
    """The figures as name and value."""
    shown = lambda value: "–" if value is None else f"{value:.3g}"  # noqa: E731
    settled = lambda error: ", ".join(shown(error[name]) for name in ("rms", "mean", "std")) + " deg/s"  # noqa: E731
    error, raw, worst = (figures[n] for n in ("rate_error_dps", "rate_error_before_filter_dps", "coefficient_error"))
    std, nis = figures["claimed_std_end_dps"], figures["nis_mean"]
    claimed = "" if std is None else f" (claimed {shown(std)})"
    rows = [
        ("run", f"{figures['duration_s']:g} s at {figures['sample_rate_hz']:g} Hz, {figures['status']}"),
        ("rate error at the end", f"{shown(error['end'])} deg/s{'' if raw else claimed}"),
        (f"rate error from {figures['settled_from_s']:g} s on (rms, mean, std)", settled(error)),
    ]
    if raw:
        rows.append(("rate error at the end before the filter", f"{shown(raw['end'])} deg/s{claimed}"))
        rows.append(("  from then on (rms, mean, std)", settled(raw)))
    if worst:
        far = max(worst, key=lambda name: abs(worst[name] or 0.0))
        rows.append(("farthest coefficient at the end", f"{far}, off by {100.0 * (worst[far] or 0.0):.3g} %"))
    told = "unknown (the observer claims no innovations)" if nis is None else f"{shown(nis)} of 2"
    rows.append(("consistency (NIS)", told))
    return rows
