"""What `memsgyro tune` does: read the study, tune, print, write."""

import json
import time
from pathlib import Path
from typing import Any

from memsgyro_jax.base.errors import InputError
from memsgyro_jax.base.files import write_whole
from memsgyro_jax.tuning.result import Tuning
from memsgyro_jax.tuning.tune import tune

from ..study import Study
from .options import chosen_study, require_writable, writing
from .progress import told


TUNED, RESULT = "tuned.toml", "tuning.json"


def run(study: Path | None, out: Path, json_file: Path | None, **settings: Any) -> None:
    """Tune, print the table, and write `tuned.toml` and `tuning.json` into `out`.

    `settings` are entries of the study's section `[sweep]`; None leaves the study's own. Evaluations are kept in `out`
    until the end, so that the same command goes on after a kill.
    """
    chosen, _ = chosen_study(study, None, **settings)
    require_writable(out / RESULT, json_file)
    started = time.monotonic()
    with writing(out, "make room or choose another folder, then give the same command again"), told() as tell:
        tuning = tune(**chosen.tune_arguments, progress=tell, keep=out / "evaluations")
        tuned = _written(tuning, chosen, out, json_file)
    print(tuning)
    print(f"\n{out / TUNED} is the tuned study, for `memsgyro sweep` and `memsgyro simulate`" if tuned else "")
    print(f"{out / RESULT} holds the details; {time.monotonic() - started:.0f} s.")


def _written(tuning: Tuning, study: Study, out: Path, json_file: Path | None) -> bool:
    """Writes the results; whether a study file can hold what was tuned."""
    text = json.dumps(tuning.as_dict(), indent=2, ensure_ascii=False, allow_nan=False) + "\n"
    for path in {out / RESULT, json_file or out / RESULT}:
        path.parent.mkdir(parents=True, exist_ok=True)
        write_whole(path, text)
    try:
        study.with_numbers(tuning.loop, tuple(number.path for number in tuning.numbers)).write(out / TUNED)
    except InputError as error:
        print(error)
        return False
    return True
