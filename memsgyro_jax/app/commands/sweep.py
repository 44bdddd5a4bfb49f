"""`memsgyro sweep`: read the study, sweep, print, write."""

import re
import tomllib
from pathlib import Path
from typing import TYPE_CHECKING

from memsgyro_jax.base.errors import InputError

from .flags import Flag
from .quick import look_for_study


if TYPE_CHECKING:
    from memsgyro_jax.montecarlo.sweep import Lot

    from ..study import Study

_SHOWS = 0.1  # of the density that is counted: half a percent of the noise


def sweep_command(
    study: Path | None = None,
    /,
    *,
    dies: int | None = None,
    seed: int | None = None,
    out: Path = Path("sweep-out"),
    resume: Flag = False,
    overwrite: Flag = False,
    part: str | None = None,
    dask: str | None = None,
    rate_record: Path | None = None,
    sample_rate: str | None = None,
    duration: str | None = None,
    block: int | None = None,
    chunk: int | None = None,
    effects: Path | None = None,
    json: Path | None = None,
) -> None:
    """Monte Carlo over fabricated dies of the closed loop.

    Prints percentiles of the rate error, the yield, and the ratio to the bound.
    Without a study file: the single-mass gyroscope of the thesis, 15 % spread.

    Args:
        study: a study file (TOML).
        dies: how many dies.
        seed: of the dies and of their noise.
        out: folder for dies.zarr, summary.json and report.html.
        resume: go on with the dies.zarr in that folder, also to more dies.
        overwrite: replace the dies.zarr in that folder.
        part: `k/n` computes the k-th of n shares of the dies and goes on where it was begun; the one that finds
            all dies done writes the summary.
        dask: address of a Dask scheduler whose workers compute, a block at a time, and write into the folder.
        rate_record: CSV with the header "t [s],rate [deg/s]" (any units), in place of the study's rate.
        sample_rate: in Hz, or with a unit: `100 kHz`.
        duration: of a run in s or with a unit; a recorded rate's own without this option.
        block: samples taken at a time, a power of two (512 at 100 kHz); a loop that cannot says why.
        chunk: dies per device and batch.
        effects: a Python file with effects of your own that the study names. It is run: trust it first.
        json: another place for a copy of summary.json.
    """
    if (resume or part) and overwrite:
        word = "--resume" if resume else "--part"
        raise InputError(f"Options `{word}` and `--overwrite` must not be given together; leave one of them out.")
    if re.match(r"[a-z0-9+]+:/", str(out)):
        raise InputError(
            f"Option `--out` must be a folder, but is {out}; other places are for `plan` and `sweep` in Python."
        )
    if part and dask:
        raise InputError("Options `--part` and `--dask` must not be given together: Dask shares the work itself.")
    share = None if part is None else _share(part)
    look_for_study(study, rate_record, effects)

    from memsgyro_jax.base.text import aligned

    from .options import chosen_study, require_writable, with_unit, writing

    chosen, notes = chosen_study(
        study, rate_record, effects, block=block, dies=dies, seed=seed, chunk=chunk,
        sample_rate=with_unit(sample_rate, "Hz"), duration=with_unit(duration, "s"),
    )  # fmt: skip
    require_writable(out / "summary.json", json)
    for note in [*notes, *_without_temperature(chosen if study else None)]:
        print(note)
    with writing(out, "make room or choose another folder, then go on with `--resume`"):
        lot = _swept(chosen, out, resume, overwrite, dask) if share is None else _part(chosen, out, share)
        if lot is None:
            return
        _write(lot, chosen, out, json)
    print(aligned(lot.summary.rows(notes=False)))  # which were told before it ran
    for note in lot.notes:
        print(f"  note: {note}")
    print(f"{out / 'report.html'}, summary.json and dies.zarr hold the details.")


def _without_temperature(study: "Study | None") -> list[str]:
    """What the Brownian force would add to a study that gives no temperature, where that is not small."""
    if study is None or study.loop.device.temperature is not None:
        return []
    from memsgyro_jax.loop.noise_budget import thermal_left_out

    said = thermal_left_out(study.loop, sample_rate=study.sweep_arguments["sample_rate"], least=_SHOWS)
    return [f"{said}."] if said else []


def _share(part: str) -> tuple[int, int]:
    number, _, count = part.partition("/")
    if not (number.isascii() and number.isdigit() and count.isascii() and count.isdigit()):
        raise InputError(f"Option `--part` must be k/n, as in 3/200, but is {part}.")
    return int(number), int(count)


def _part(study: "Study", out: Path, part: tuple[int, int]) -> "Lot | None":
    """Compute a share; the lot when that was the last."""
    from memsgyro_jax.montecarlo.parts import plan, run_part
    from memsgyro_jax.montecarlo.standing import standing_of
    from memsgyro_jax.montecarlo.sweep import lot_of

    from .progress import progress

    with progress("dies", "compiling") as show:
        store = plan(**study.sweep_arguments, out=out)
        ran = run_part(store, part, progress=show)
    print(ran)
    found = standing_of(out)
    if found.finished:
        return lot_of(store, ran)
    print(found)
    return None


def _swept(study: "Study", out: Path, resume: bool, overwrite: bool, dask: str | None) -> "Lot":
    from memsgyro_jax.montecarlo.store import discard
    from memsgyro_jax.montecarlo.sweep import sweep

    from .progress import progress

    if overwrite:
        discard(out / "dies.zarr")
    with progress("dies", "compiling") as show:
        return sweep(**study.sweep_arguments, out=out, resume=resume, dask=dask, progress=show)


def _write(lot: "Lot", study: "Study", out: Path, json: Path | None) -> None:
    from memsgyro_jax.base.files import write_json, write_whole

    from ..report.sweep_page import sweep_page

    page = sweep_page(lot, study).html()
    figures = {**lot.summary.as_dict(), "study": tomllib.loads(study.to_toml())}
    for path in {out / "summary.json", json or out / "summary.json"}:
        write_json(path, figures)
    write_whole(out / "report.html", page)
