"""`memsgyro simulate`: read the study, run one die, print, write."""

import warnings
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from memsgyro_jax.base.errors import InputError

from .quick import look_for_study


if TYPE_CHECKING:
    from memsgyro_jax.loop.trace_result import Trace
    from memsgyro_jax.measurement.case import Environment

    from ..study import Study


_ROWS = 4000  # samples kept, at most about this many


def simulate_command(
    study: Path | None = None,
    /,
    *,
    rate_record: Path | None = None,
    die: int | None = None,
    seed: int | None = None,
    sample_rate: str | None = None,
    duration: str | None = None,
    block: int | None = None,
    out: Path | None = None,
    case: Path | None = None,
    record: str = "run",
    role: Literal["fit", "validation"] | None = None,
    effects: Path | None = None,
    json: Path | None = None,
) -> None:
    """One run of the closed loop.

    Args:
        study: a study file (TOML); without it the single-mass gyroscope of the thesis.
        rate_record: CSV with the header "t [s],rate [deg/s]" (any units), in place of the study's rate.
        die: number of a die of the study's sweep; without it the design itself runs.
        seed: of the dies and of their noise.
        sample_rate: in Hz, or with a unit: `100 kHz`.
        duration: of the run in s or with a unit; a recorded rate's own without this option.
        block: samples taken at a time, a power of two (512 at 100 kHz); a loop that cannot says why.
        out: folder for trace.zarr, summary.json and report.html.
        case: folder of a measurement case to which the run is added as raw signals, or that is made.
        record: name of the run in that case.
        role: of the run in that case.
        effects: a Python file with effects of your own that the study names. It is run: trust it first.
        json: file for the machine-readable result.
    """
    if block is not None and case is not None:
        raise InputError("Options `--block` and `--case` must not be given together: a case holds every sample.")
    if die is not None and die < 0:
        raise InputError(f"Option `--die` must be the number of a die, 0 or more, but {die} was given.")
    look_for_study(study, rate_record, effects)
    import tomllib

    from memsgyro_jax.base.files import write_json
    from memsgyro_jax.base.text import aligned
    from memsgyro_jax.loop.trace import count_steps, simulate

    from ..report.run_summary import run_figures, run_rows
    from .options import chosen_study, require_writable, with_unit, writing

    chosen, notes = chosen_study(
        study, rate_record, effects, block=block, seed=seed,
        sample_rate=with_unit(sample_rate, "Hz"), duration=with_unit(duration, "s"),
    )  # fmt: skip
    require_writable(out and out / "summary.json", json)
    for note in notes:
        print(note)
    plan = chosen.settings
    loop, scenario = chosen.die(die)
    if case is not None:
        from memsgyro_jax.measurement.loop_record import require_recordable

        require_recordable(loop)
        loop = replace(loop, blocks=None)  # a case holds every sample
    decimation = 1 if case else max(1, count_steps(plan.sample_rate, plan.duration) // _ROWS)
    trace = simulate(
        loop, scenario, sample_rate=plan.sample_rate, duration=plan.duration, seed=plan.seed, die=die or 0,
        decimation=decimation,
    )  # fmt: skip
    figures = run_figures(trace, plan.settle)
    print(aligned(run_rows(figures)))
    figures = {**figures, "study": tomllib.loads(chosen.to_toml())}
    with writing(out or json or Path(), "make room or choose another folder"):
        if out is not None:
            _write(trace, chosen, figures, out)
        if json is not None:
            write_json(json, figures)
    if case is not None:
        around = _environment(chosen)
        with warnings.catch_warnings(record=True) as caveats:
            warnings.simplefilter("always")
            written = trace.to_case(case, name=record, role=role, design=chosen.loop.device, environment=around)
        for caveat in caveats:
            print(caveat.message)
        print(f"{written} holds the run, for `memsgyro check`, `compare`, `diagnose` and `fit`.")
    if out is not None:
        print(f"{out / 'report.html'}, summary.json and trace.zarr hold the details.")


def _environment(study: "Study") -> "Environment":
    """Temperature and bias voltage at the beginning; a case knows one of each."""
    from memsgyro_jax.measurement.case import Environment

    device, start = study.loop.device, study.scenario.at(0.0)
    given = (start.temperature, start.bias_voltage)
    held = (device.reference_temperature, device.reference_bias)
    return Environment(*(own if now is None else float(now) for now, own in zip(given, held, strict=True)))


def _write(trace: "Trace", study: "Study", figures: dict[str, Any], out: Path) -> None:
    from memsgyro_jax.base.files import write_json, write_whole

    from ..report.run_summary import run_rows
    from ..report.trace_page import trace_page

    page = trace_page(trace, study, run_rows(figures)).html()
    out.mkdir(parents=True, exist_ok=True)
    trace.save(out / "trace.zarr")
    write_json(out / "summary.json", figures)
    write_whole(out / "report.html", page)
