"""A user's own kinds of measurement: a Python file in, classes out, or one sentence that says what to mend."""

import inspect
from pathlib import Path

from memsgyro_jax.base.errors import InputError
from memsgyro_jax.base.text import listed
from memsgyro_jax.base.user_file import run_user_file

from .experiments import AbstractRecord
from .experiments.base import Experiment


def load_kinds(path: str | Path) -> tuple[type[AbstractRecord], ...]:
    """Kinds of measurement that a Python file defines, for `load_case(folder, kinds=...)`: its records.

    Running a file is running a program: load only what you would run.

    Raises:
        InputError: with file and line, if the file does not run, defines no record, or one that lacks a method or its
            `kind`.
    """
    file = run_user_file(path)
    kinds = file.final(AbstractRecord)  # type: ignore[type-abstract]
    if not kinds:
        raise InputError(
            f"{path}: must define a kind of measurement, a subclass of `memsgyro_jax.measurement.experiments."
            "AbstractRecord`, but defines none."
        )
    for kind in kinds:
        if inspect.isabstract(kind):
            missing = ", ".join(f"`{method}`" for method in sorted(kind.__abstractmethods__))
            raise InputError(f"{file.at(kind)}: record `{kind.__name__}` must have {missing}, but has not.")
        if not isinstance(getattr(kind, "kind", None), str):
            raise InputError(
                f"{file.at(kind)}: record `{kind.__name__}` must have the word that `case.toml` has for it, e.g. "
                '`kind = "static_deflection"`, but has none.'
            )
    for experiment in file.final(Experiment):  # type: ignore[type-abstract]
        lacking = sorted(experiment.__abstractmethods__ | getattr(experiment, "__abstractvars__", set()))
        if lacking:
            named = listed(lacking, "`")
            raise InputError(
                f"{file.at(experiment)}: experiment `{experiment.__name__}` must have {named}, but has not."
            )
    return tuple(kinds)
