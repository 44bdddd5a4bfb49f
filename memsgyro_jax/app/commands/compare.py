"""What `memsgyro compare` does: read, fit or take a model, print where it fails, write."""

from pathlib import Path

from memsgyro_jax.base.errors import InputError
from memsgyro_jax.base.files import write_whole
from memsgyro_jax.diagnosis.compare import compare
from memsgyro_jax.effects import load_effects
from memsgyro_jax.measurement.case import load_case
from memsgyro_jax.measurement.model_file import read_model


def run(case: Path, model: Path | None, json: Path | None, effects: Path | None) -> None:
    """Compare, print, and write what was asked for; a model from a file is taken as it is."""
    if effects is not None and model is None:
        raise InputError("Option `--effects` must go with `--model`, whose effects it defines; leave it out.")
    measured = load_case(case)
    own = load_effects(effects, measured.channels) if effects else ()
    given = None if model is None else read_model(model, own)
    result = compare(given, measured, fitted=model is None)
    print(result)
    if json is not None:
        write_whole(json, result.to_json() + "\n")
