"""`memsgyro check`: read a measurement case, say what it holds, how good it is, and what it can identify."""

from pathlib import Path
from textwrap import indent

from .cases import cases_in, only_of_folders, over_cases
from .diagnose import load_demo_or, look_for


def check_command(
    case: Path,
    /,
    *,
    kinds: Path | None = None,
    out: Path | None = None,
    jobs: int = 1,
    dask: str | None = None,
) -> None:
    """What a measurement case holds, how good it is, and what it can identify.

    Prints the experiments, their noise and their largest readings.
    Warns of rows that stand alone, of noise that is not the declared one,
    and of records too short for the device. Says to how many per cent
    each record would hold each parameter of the base model, and which not at all.

    Args:
        case: folder with a case.toml and the CSV files that it names, the word demo for the one that comes along, or a
            folder of such folders, each of which is checked.
        kinds: a Python file with kinds of measurement of your own. It is run: trust it first.
        out: folder for what is said of many cases, `check-out` without this option. What is there is not done again.
        jobs: how many of many cases are checked at a time.
        dask: address of a Dask scheduler whose workers check many cases, one a task, and write into the folder.
    """
    if cases_in(case):
        return over_cases("check", case, out, options={"kinds": kinds}, made={}, jobs=jobs, dask=dask, table=None)
    only_of_folders(out=out, jobs=jobs, dask=dask)
    look_for(case, kinds)
    from memsgyro_jax.base.text import listed
    from memsgyro_jax.diagnosis.identifiable import identifiable
    from memsgyro_jax.diagnosis.settings_table import settings_table
    from memsgyro_jax.measurement.beside_design import beside_design
    from memsgyro_jax.measurement.case import assess
    from memsgyro_jax.measurement.readings import roles_of
    from memsgyro_jax.measurement.user_kinds import load_kinds

    measured = load_demo_or(case, load_kinds(kinds) if kinds else ())
    for part in (measured, assess(measured)):
        print(part, end="\n\n", flush=True)
    for sentence in beside_design(measured):
        print(sentence)
    if table := settings_table(measured):
        print(f"The device as each of its surroundings shows it by itself:\n{indent(table, '  ')}")
    print("What the fitted records can identify of the base model, by the size of one standard deviation:")
    for line in identifiable(measured):
        print(f"  {line}")
    named = [(record.name, role) for record, role in zip(measured.records, roles_of(measured), strict=True)]
    if halves := [name for name, role in named if role == "both"]:
        print(f"  half of the rows of {listed(halves)} are fitted, the others judge the model")
    if judges := [name for name, role in named if role == "validation"]:
        print(f"  held out: {listed(judges)}: not fitted, it judges the model")
    return None
