"""How figures of a lot are written, for people and in JSON."""

import numpy as np

from .following import Following
from .merit import Percentiles, Ratio, StraightError


def triple(error: Percentiles) -> str:
    """Root mean square, median and 95th percentile."""
    return "{:.3g}, {:.3g}, {:.3g} deg/s".format(*np.degrees([error.rms, error.p50, error.p95]))


def sound_text(error: Percentiles) -> str:
    """The same of the dies that did not diverge, which may be none."""
    return triple(error) if np.isfinite(error.rms) else "none, as every die that is not lost diverged"


def reached_text(reached: Ratio, dies: int) -> str:
    """Errors over bounds, and of how many of the `dies`."""
    share = "" if reached.dies >= dies else f"; over {reached.dies} of {dies} dies"
    return f"x {reached.value:.3g} rms ({reached.low:.3g} to {reached.high:.3g}), median x {reached.median:.3g}{share}"


def following_entries(result: Following) -> dict[str, object]:
    """How a varying rate was followed, for JSON."""
    return {
        "rms_dps": float(np.degrees(result.rms)),
        "delay_s": result.delay,
        "delay_interval_s": result.delay_interval,
        "bandwidth_hz": result.bandwidth,
        "bandwidth_interval_hz": result.bandwidth_interval,
    }


def following_text(result: Following, duration: float) -> str:
    """How a varying rate was followed in a run of `duration` [s]."""
    told, low, high = (1e3 * t for t in (result.delay, *result.delay_interval))
    # An output that is not late, or early, is told by how late it is at most.
    delay = f"{told:.3g} ms ({low:.3g} to {high:.3g})" if low > 0.0 or high < 0.0 else f"below {high:.3g} ms"
    delay = delay if high < 1e3 * duration else "not shown by this run"
    band = "not shown by this rate"
    if result.bandwidth is not None and result.bandwidth_interval is not None:
        band = "{:.3g} Hz ({:.3g} to {:.3g})".format(result.bandwidth, *result.bandwidth_interval)
    return f"rms {np.degrees(result.rms):.3g} deg/s, delay {delay}, bandwidth {band}"


def straight_entries(error: StraightError, moves: bool) -> dict[str, object]:
    """Bias and scale-factor error for JSON; of a rate that `moves` the mean error, under its own name."""
    bias = {"value": float(np.degrees(error.bias)), "std": float(np.degrees(error.bias_std))}
    if moves:
        return {"mean_error_dps": bias}
    return {"bias_dps": bias, "scale_factor_error": {"value": error.scale, "std": error.scale_std}}


def straight_name(moves: bool) -> str:
    """What the figures of `straight_text` are; no error of a rate that `moves` is a bias alone."""
    return "mean rate error" if moves else "bias, scale-factor error"


def straight_text(error: StraightError, moves: bool) -> str:
    """Bias and scale-factor error with their standard errors, and what these are."""
    bias = f"{np.degrees(error.bias):.3g} ± {np.degrees(error.bias_std):.2g} deg/s"
    if moves:
        return f"{bias} (over the dies, ± its standard error; the lag behind a moving rate is in it)"
    if error.scale is None or error.scale_std is None:
        mean = "(mean over the dies ± its standard error)"
        return f"{bias} {mean}, unknown (all dies turn alike: spread `scenario.rate.level`)"
    scale = f"{100.0 * error.scale:.3g} ± {100.0 * error.scale_std:.2g} %"
    return f"{bias}, {scale} (line through the dies ± standard errors)"


def lost_text(lost_at: tuple[float, float, float], travel: float | None) -> str:
    """When dies were lost, and by what, a `travel` [m] being known."""
    times = "{:.3g}, {:.3g}, {:.3g} ms".format(*(1e3 * time for time in lost_at))
    return times if travel is None else f"{times}: beyond {1e6 * travel:.4g} µm (`travel`), or not finite"
