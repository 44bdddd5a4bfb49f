"""`memsgyro check`: read a measurement case, say what it holds, how good it is, and what it can identify."""

from pathlib import Path

from .diagnose import load_demo_or, look_for


def check_command(case: Path, /, *, kinds: Path | None = None) -> None:
    """What a measurement case holds, how good it is, and what it can identify.

    Prints the experiments, their noise and their largest readings.
    Warns of rows that stand alone, of noise that is not the declared one,
    and of records too short for the device. Says to how many per cent
    each record would hold each parameter of the base model, and which not at all.

    Args:
        case: folder with a case.toml and the CSV files that it names, or the word demo for the one that comes along.
        kinds: a Python file with kinds of measurement of your own. It is run: trust it first.
    """
    look_for(case, kinds)
    from memsgyro_jax.diagnosis.identifiable import identifiable
    from memsgyro_jax.measurement.case import assess
    from memsgyro_jax.measurement.user_kinds import load_kinds

    measured = load_demo_or(case, load_kinds(kinds) if kinds else ())
    for part in (measured, assess(measured)):
        print(part, end="\n\n", flush=True)
    print("What the fitted records can identify of the base model, by the size of one standard deviation:")
    for line in identifiable(measured):
        print(f"  {line}")
