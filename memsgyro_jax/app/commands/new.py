"""`memsgyro new`: a commented file to begin with."""

from pathlib import Path
from typing import Annotated, Literal

import cyclopts

from memsgyro_jax.base.errors import InputError


def new_command(
    kind: Literal["study", "case", "effect"],
    path: Path | None = None,
    /,
    *,
    out: Path | None = None,
    purpose: Annotated[Literal["sweep", "datasheet", "tune", "layout"], cyclopts.Parameter(name="--for")] = "sweep",
) -> None:
    """Writes a commented study file, measurement case or effect of one's own, which runs as it is.

    Beside a study or in a case lies the schema that an editor checks it against.

    Args:
        kind: what to write.
        path: the file, or the folder of a case; study.toml, case or my_effect.py without it.
        out: the same, as other commands take it.
        purpose: what a study is for: sweeps with a Kalman filter, the datasheet of a phase-locked gyro, tuning, or a
            device by its drawing and process.
    """
    usual = {"study": "study.toml", "case": "case", "effect": "my_effect.py"}
    if path is not None and out is not None:
        raise InputError(f"Option `--out` must not be given beside a path, but is `{out}` beside `{path}`.")
    path = path or out or Path(usual[kind])
    if purpose != "sweep" and kind != "study":
        raise InputError(f"Option `--for` must go with a study, but a new {kind} was asked for.")
    if path.exists():
        raise InputError(f"{path} exists already; choose another name, or remove it.")
    from memsgyro_jax.base.files import json_text, write_whole

    from . import templates
    from .schema import schema_of

    folder = path if kind == "case" else path.parent
    folder.mkdir(parents=True, exist_ok=True)
    if kind == "effect":
        write_whole(path, templates.EFFECT.format(name=path.name))
        print(f"{path} is an effect of your own; `memsgyro effects {path}` checks and lists it.")
        return
    schema = write_whole(folder / f"{kind}.schema.json", json_text(schema_of(kind)) + "\n").name
    if kind == "study":
        write_whole(path, templates.STUDIES[purpose].format(name=path.name, schema=schema))
        runs = "sweep" if purpose == "layout" else purpose
        print(f"{path} is a study; `memsgyro {runs} {path}` runs it.")
        return
    for name, (drive, seed) in {"low": (1.0, 0), "high": (3.0, 1), "check": (2.0, 2)}.items():
        write_whole(path / f"{name}.csv", _resonance(drive, seed))
    write_whole(path / "case.toml", templates.CASE.format(name=path.name, schema=schema))
    print(f"{path} is a measurement case; `memsgyro check {path}` reads it.")


def _resonance(drive: float, seed: int) -> str:
    """Rows of a sweep across a resonance at 3 kHz with a quality factor of 900, with 50 µV of noise on I and Q."""
    import numpy as np

    frequency, noise = np.linspace(2985.0, 3015.0, 121), np.random.default_rng(seed).standard_normal((121, 2))
    ratio = frequency / 3000.0
    phasor = 1e-3 * drive / (1.0 - ratio**2 + 1j * ratio / 900.0) + 50e-6 * (noise[:, 0] + 1j * noise[:, 1])
    rows = (f"{drive:g},{f:.6g},{z.real:.6g},{z.imag:.6g}" for f, z in zip(frequency, phasor, strict=True))
    return "\n".join(["drive [V],f [Hz],X [V],Y [V]", *rows]) + "\n"
