"""`memsgyro tune`: read the study, tune, print, write."""

import time
from pathlib import Path

from memsgyro_jax.base.errors import InputError

from .quick import look_for_study


TUNED, RESULT = "tuned.toml", "tuning.json"


def tune_command(
    study: Path | None = None,
    /,
    *,
    dies: int | None = None,
    seed: int | None = None,
    out: Path = Path("tune-out"),
    effects: Path | None = None,
    json: Path | None = None,
) -> None:
    """Gains, noises and bandwidths by gradient through the closed loop.

    Prints what moved and what has no effect, and the error of unseen dies
    before and after; warns where the gains absorb an error of the model.
    Evaluations are kept until the end: the same command goes on after a kill.

    Args:
        study: a study file (TOML); its section [tune] says what is free.
        dies: how many unseen dies are reported, as in a sweep.
        seed: of the dies and of their noise.
        out: folder for tuned.toml (a study file for sweep and simulate) and tuning.json.
        effects: a Python file with effects of your own that the study names. It is run: trust it first.
        json: another place for a copy of tuning.json.
    """
    look_for_study(study, effects)
    from memsgyro_jax.base.files import write_json
    from memsgyro_jax.tuning.tune import tune

    from .options import chosen_study, require_writable, writing
    from .progress import told

    chosen, notes = chosen_study(study, None, effects, dies=dies, seed=seed)
    require_writable(out / RESULT, json)
    for note in notes:
        print(note)
    started = time.monotonic()
    with writing(out, "make room or choose another folder, then give the same command again"), told() as tell:
        tuning = tune(**chosen.tune_arguments, progress=tell, keep=out / "evaluations")
        for path in {out / RESULT, json or out / RESULT}:
            path.parent.mkdir(parents=True, exist_ok=True)
            write_json(path, tuning.as_dict())
        try:
            chosen.with_numbers(tuning.loop, tuple(number.path for number in tuning.numbers)).write(out / TUNED)
            written = f"{out / TUNED} is the tuned study, for `memsgyro sweep` and `memsgyro simulate`"
        except InputError as error:  # a study file cannot hold what was tuned
            written = str(error)
    print(tuning)
    print(f"\n{written}\n{out / RESULT} holds the details; {time.monotonic() - started:.0f} s.")
