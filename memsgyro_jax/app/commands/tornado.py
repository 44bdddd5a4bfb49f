"""`memsgyro tornado`: read the study, move one parameter of its spread after the other, print, write."""

from dataclasses import replace
from pathlib import Path

from .flags import Flag
from .quick import look_for_study


def tornado_command(
    study: Path | None = None,
    /,
    *,
    zero_rate: Flag = False,
    sigmas: float = 1.0,
    repeats: int = 8,
    seed: int | None = None,
    report: Path | None = None,
    effects: Path | None = None,
    json: Path | None = None,
) -> None:
    """Which parameter of the spread matters: a tornado, one at a time.

    Prints by how much the rate error changes with each parameter a standard
    deviation below and above its design, the largest first, beside what the
    gradient at the design says.

    Args:
        study: a study file (TOML), whose [spread] is taken apart; without it that of the thesis.
        zero_rate: look at the zero-rate output instead: no rate, no noise of the read-out, mean of the settled part.
        sigmas: how many standard deviations a parameter is moved, either way.
        repeats: runs at each point, each with a noise of its own; one gives no standard error.
        seed: of the noise.
        report: file for a page with the bars.
        effects: a Python file with effects of your own that the study names. It is run: trust it first.
        json: file for the machine-readable result.
    """
    look_for_study(study, effects)
    from memsgyro_jax.base.files import write_json
    from memsgyro_jax.loop.scenario import Constant
    from memsgyro_jax.montecarlo.sensitivity import mean_error, tornado

    from .options import chosen_study, require_writable, writing
    from .progress import progress

    chosen, notes = chosen_study(study, None, effects, seed=seed)
    require_writable(report, json)
    for note in notes:
        print(note)
    run = chosen.sweep_arguments
    settings = {name: run.get(name) for name in ("sample_rate", "duration", "settle", "tolerance", "seed")}
    loop, spread, scenario, of = run["loop"], run["spread"], run["scenario"], None
    if zero_rate:
        settle = settings["settle"]
        off = mean_error(0.5 if settle is None else settle / settings["duration"])
        loop, spread = loop.silent, spread.of_silent.without("scenario.rate.")
        scenario = replace(scenario, rate=Constant(0.0))
        of = [replace(off, name="zero-rate output")]
    if repeats == 1:
        print("One noise at each point: bars have no standard error; two or more `--repeats` give one.", flush=True)
    with progress("dies", "compiling") as show:
        bars = tornado(loop, spread, scenario, sigmas=sigmas, repeats=repeats, of=of, progress=show, **settings)
    print(bars)
    with writing(report or json or Path(), "make room and run again"):
        if report is not None:
            from ..report.loop_pages import tornado_page

            print(f"\n{tornado_page(bars, chosen).save(report)} is the page.")
        if json is not None:
            write_json(json, bars.as_dict())
