"""`memsgyro compare`: read, fit or take a model, print where it fails, write."""

from pathlib import Path

from memsgyro_jax.base.errors import InputError

from .cases import cases_in, only_of_folders, over_cases
from .diagnose import load_demo_or, look_for
from .flags import Flag


def compare_command(
    case: Path,
    /,
    *,
    model: Path | None = None,
    effects: Path | None = None,
    kinds: Path | None = None,
    exit_code: Flag = False,
    json: Path | None = None,
    out: Path | None = None,
    jobs: int = 1,
    dask: str | None = None,
) -> None:
    """Where a model fails to explain a measurement case.

    Prints the error of every experiment over its noise, then each failure:
    experiment, drive level, temperature or time, frequency, channel.
    A few rows that stand alone, without which the model explains the case,
    are named and left out.

    Args:
        case: folder with a case.toml and the CSV files that it names, the word demo for the one that comes along, or a
            folder of such folders, each of which is compared.
        model: a model file, taken as it is; without it the base model is fitted.
        effects: a Python file with effects of your own that the model has. It is run: trust it first.
        kinds: a Python file with kinds of measurement of your own. It is run: trust it first.
        exit_code: end with status 1 where the model does not explain the case, for scripts.
        json: file for the machine-readable result, of many cases for their table.
        out: folder for the results of many cases, `compare-out` without this option. What is there is not done again.
        jobs: how many of many cases are compared at a time.
        dask: address of a Dask scheduler whose workers compare many cases, one a task, and write into the folder.
    """
    if effects is not None and model is None:
        raise InputError("Option `--effects` must go with `--model`, whose effects it defines; leave it out.")
    if cases_in(case):
        options, made = {"model": model, "effects": effects, "kinds": kinds}, {"--json": "comparison.json"}
        return over_cases("compare", case, out, options=options, made=made, jobs=jobs, dask=dask, table=json)
    only_of_folders(out=out, jobs=jobs, dask=dask)
    look_for(case, model, effects, kinds)
    from memsgyro_jax.base.files import write_json
    from memsgyro_jax.diagnosis.compare import compare
    from memsgyro_jax.effects import load_effects
    from memsgyro_jax.measurement.model_file import read_model
    from memsgyro_jax.measurement.user_kinds import load_kinds

    from .options import require_writable

    require_writable(json)
    measured = load_demo_or(case, load_kinds(kinds) if kinds else ())
    own = load_effects(effects, measured.channels) if effects else ()
    result = compare(None if model is None else read_model(model, own), measured, fitted=model is None)
    print(result)
    if json is not None:
        write_json(json, result.to_dict())
    if exit_code and not result.explained:
        raise SystemExit(1)
    return None
