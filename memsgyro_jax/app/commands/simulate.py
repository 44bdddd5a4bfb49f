"""What `memsgyro simulate` does: read the study, run one die, print, write."""

import json
import shutil
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from memsgyro_jax.base.errors import InputError
from memsgyro_jax.base.files import finite, write_whole
from memsgyro_jax.loop.loop import ClosedLoop
from memsgyro_jax.loop.scenario import Scenario
from memsgyro_jax.loop.trace import Trace, count_steps, simulate
from memsgyro_jax.montecarlo.store import LABELS

from ..study import Study
from .options import chosen_study, require_writable, writing


SCHEMA = "memsgyro-run/1"
_ROWS = 4000  # samples kept, at most about this many


def run(
    study: Path | None,
    rate_record: Path | None,
    out: Path | None,
    json_file: Path | None,
    die: int | None,
    **settings: Any,
) -> None:
    """Run one die, print how it went, and write `trace.zarr`, `summary.json` and `report.html` into `out`, if given.

    `die` is a number of the study's sweep; None runs the design itself. `settings` as in `sweep.run`.
    """
    if die is not None and die < 0:
        raise InputError(f"Option `--die` must be the number of a die, 0 or more, but {die} was given.")
    chosen, notes = chosen_study(study, rate_record, **settings)
    require_writable(out and out / "summary.json", json_file)
    for note in notes:
        print(note)
    plan = chosen.settings
    loop, scenario = (chosen.loop, chosen.scenario) if die is None else _die(chosen, die)
    decimation = max(1, count_steps(plan.sample_rate, plan.duration) // _ROWS)
    trace = simulate(
        loop, scenario, sample_rate=plan.sample_rate, duration=plan.duration, seed=plan.seed, die=die or 0,
        decimation=decimation,
    )  # fmt: skip
    figures = summary(trace, plan.settle)
    print(_lines(rows(figures)))
    text = json.dumps(figures, indent=2, ensure_ascii=False, allow_nan=False) + "\n"
    with writing(out or json_file or Path(), "make room or choose another folder"):
        if out is not None:
            _write(trace, chosen, figures, out, text)
        if json_file is not None:
            write_whole(json_file, text)
    if out is not None:
        print(f"{out / 'report.html'}, summary.json and trace.zarr hold the details.")


def _die(study: Study, die: int) -> tuple[ClosedLoop, Scenario]:
    """Die `die` of the sweep, as a loop of one die."""
    drawn = study.spread.draw(study.loop, study.scenario, study.settings.seed, np.array([die]))
    return jax.tree.map(
        lambda one, design: one[..., 0] if jnp.ndim(one) > jnp.ndim(design) else one,
        (drawn.loop, drawn.scenario),
        (study.loop, study.scenario),
    )


def summary(trace: Trace, settle: float | None) -> dict[str, Any]:
    """The content of `summary.json`; not-a-number (a lost die, an observer without covariance) is None."""
    begin = 0.5 * trace.settings.duration if settle is None else settle
    entries = {
        "schema": SCHEMA,
        "status": trace.status,
        "lost_at_s": trace.lost_at,
        "rate_error_dps": _error(trace.rate_error, trace.time >= begin),
        "rate_error_before_filter_dps": _error(trace.rate_unfiltered - trace.rate_true, trace.time >= begin)
        if trace.filtered
        else None,
        "claimed_std_end_dps": float(np.degrees(trace.rate_std[-1])),
        "nis_mean": float(np.mean(trace.nis)),
        "coefficient_error": {
            name: float(trace.theta_estimate[-1, i] / trace.theta[i] - 1.0)
            for i, name in enumerate(trace.coefficients)
            if not name.startswith("rate")
        },
        "settled_from_s": begin,
        **{f"{name}{unit}": value for (name, value), unit in zip(_settings(trace), ("_hz", "_s", "", ""), strict=True)},
        "versions": dict(trace.settings.versions),
    }
    return finite(entries)


def _error(error: np.ndarray, settled: np.ndarray) -> dict[str, float]:
    """End, and root mean square, mean and standard deviation over the settled samples, in deg/s."""
    end = float(np.degrees(error[-1]))
    chosen = np.degrees(error[settled] if settled.any() else error[-1:])
    rms = float(np.sqrt(np.mean(chosen**2)))
    return {"end": end, "rms": rms, "mean": float(np.mean(chosen)), "std": float(np.std(chosen))}


def _settings(trace: Trace) -> list[tuple[str, Any]]:
    given = trace.settings
    names = ("sample_rate", "duration", "seed", "fingerprint")
    return [(name, getattr(given, name)) for name in names]


def rows(figures: dict[str, Any]) -> list[tuple[str, str]]:
    """The figures as name and value."""
    shown = lambda value: "–" if value is None else f"{value:.3g}"  # noqa: E731
    error, raw, worst = (figures[n] for n in ("rate_error_dps", "rate_error_before_filter_dps", "coefficient_error"))
    claimed = f"claimed {shown(figures['claimed_std_end_dps'])}"
    far = max(worst, key=lambda name: abs(worst[name] or 0.0))
    return [
        ("run", f"{figures['duration_s']:g} s at {figures['sample_rate_hz']:g} Hz, {figures['status']}"),
        ("rate error at the end", f"{shown(error['end'])} deg/s{'' if raw else f' ({claimed})'}"),
        (f"rate error from {figures['settled_from_s']:g} s on (rms, mean, std)",
         ", ".join(shown(error[name]) for name in ("rms", "mean", "std")) + " deg/s"),
        *([("rate error at the end before the filter", f"{shown(raw['end'])} deg/s ({claimed})"),
           ("  from then on (rms, mean, std)",
            ", ".join(shown(raw[name]) for name in ("rms", "mean", "std")) + " deg/s")] if raw else []),
        ("farthest coefficient at the end", f"{far}, off by {100.0 * (worst[far] or 0.0):.3g} %"),
        ("consistency (NIS)", f"{shown(figures['nis_mean'])} of 2"),
    ]  # fmt: skip


def _lines(table: list[tuple[str, str]]) -> str:
    width = max(len(name) for name, _ in table)
    return "\n".join(f"{name:<{width}}  {value}" for name, value in table)


def _write(trace: Trace, study: Study, figures: dict[str, Any], out: Path, text: str) -> None:
    from ..report.trace_page import trace_page

    page = trace_page(trace, study, rows(figures)).html()
    out.mkdir(parents=True, exist_ok=True)
    _write_store(trace, out / "trace.zarr")
    write_whole(out / "summary.json", text)
    write_whole(out / "report.html", page)


def _write_store(trace: Trace, path: Path) -> None:
    """The trace as a zarr group, in place of an earlier one; text coordinates become attributes, as in `dies.zarr`."""
    data = trace.to_xarray()
    texts = {str(name): list(map(str, c.values)) for name, c in data.coords.items() if c.dtype.kind in "UO"}
    draft = path.with_name(f".{path.name}.part")
    shutil.rmtree(draft, ignore_errors=True)
    try:
        stored = data.drop_vars(list(texts)).assign_attrs({LABELS: texts})
        stored.to_zarr(draft, zarr_format=3, consolidated=False)
        shutil.rmtree(path, ignore_errors=True)
        draft.rename(path)
    finally:
        shutil.rmtree(draft, ignore_errors=True)
