"""The command line `memsgyro`.

Commands are small functions that import what they run inside their body, so that `--help` answers without importing
JAX. Each prints for people, writes files only where it is told to, and leaves errors to `main`: what the user can mend
is one sentence and exit status 2.
"""

import os
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Literal

import cyclopts

from memsgyro_jax import __version__
from memsgyro_jax.base.errors import InputError


BAD_INPUT = 2
INTERRUPTED = 130
BROKEN_PIPE = 1  # as rich does

app = cyclopts.App(
    name="memsgyro",
    help="Simulates vibratory gyroscopes in closed loop, one die or thousands, and lays them beside measurements.",
    version=__version__,
    help_format="plaintext",  # markdown would cost a third of the time that `--help` takes
    suppress_keyboard_interrupt=False,  # `main` answers it
)


def main(tokens: Sequence[str] | None = None) -> None:
    """Runs `memsgyro` and ends the process with its exit status.

    0 is success, 2 bad input or an unusable file (one sentence on standard error), 130 an interruption by Ctrl-C.

    Args:
        tokens: the command line without the program's name; `None` takes it from the process.
    """
    sys.exit(_run(app, sys.argv[1:] if tokens is None else tokens))


def _run(application: cyclopts.App, tokens: Sequence[str]) -> int:
    try:
        application(
            list(tokens), exit_on_error=False, print_error=False, help_on_error=False, result_action="return_value"
        )
        sys.stdout.flush()
    except InputError as error:
        return _say(str(error), BAD_INPUT)
    except cyclopts.CycloptsError as error:
        return _say(f"{_one_line(str(error))} See `memsgyro --help`.", BAD_INPUT)
    except KeyboardInterrupt:
        return _say("Interrupted.", INTERRUPTED)
    except BrokenPipeError:
        # The reader of the pipe has left (`memsgyro ... | head`); Python would complain when it closes the stream.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return BROKEN_PIPE
    except OSError as error:
        return _say(_file_sentence(error), BAD_INPUT)
    return 0


def _say(sentence: str, status: int) -> int:
    print(_one_line(sentence), file=sys.stderr)
    return status


def _one_line(text: str) -> str:
    return " ".join(text.split())


def _file_sentence(error: OSError) -> str:
    """Disk full, no permission, no such file: the file first, then the system's own words."""
    reason = error.strerror or str(error) or type(error).__name__
    return f"{error.filename}: {reason}." if error.filename else f"{reason}."


_Flag = Annotated[bool, cyclopts.Parameter(negative=())]


@app.command
def sweep(
    study: Path | None = None,
    /,
    *,
    dies: int | None = None,
    seed: int | None = None,
    out: Path = Path("sweep-out"),
    resume: _Flag = False,
    overwrite: _Flag = False,
    rate_record: Path | None = None,
    sample_rate: float | None = None,
    duration: float | None = None,
    chunk: int | None = None,
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
        rate_record: CSV with the header "t [s],rate [deg/s]" (any units), in place of the study's rate.
        sample_rate: in Hz.
        duration: of a run in s; a recorded rate's own without this option.
        chunk: dies per device and batch.
        json: another place for a copy of summary.json.
    """
    from memsgyro_jax.base.runtime import configure

    configure()
    from .commands.sweep import run

    run(
        study, rate_record, out, resume, overwrite, json, dies=dies, seed=seed, chunk=chunk,
        sample_rate=_with_unit(sample_rate, "Hz"), duration=_with_unit(duration, "s"),
    )  # fmt: skip


@app.command
def simulate(
    study: Path | None = None,
    /,
    *,
    rate_record: Path | None = None,
    die: int | None = None,
    seed: int | None = None,
    sample_rate: float | None = None,
    duration: float | None = None,
    out: Path | None = None,
    json: Path | None = None,
) -> None:
    """One run of the closed loop.

    Args:
        study: a study file (TOML); without it the single-mass gyroscope of the thesis.
        rate_record: CSV with the header "t [s],rate [deg/s]" (any units), in place of the study's rate.
        die: number of a die of the study's sweep; without it the design itself runs.
        seed: of the dies and of their noise.
        sample_rate: in Hz.
        duration: of the run in s; a recorded rate's own without this option.
        out: folder for trace.zarr, summary.json and report.html.
        json: file for the machine-readable result.
    """
    from memsgyro_jax.base.runtime import configure

    configure()
    from .commands.simulate import run

    run(
        study, rate_record, out, json, die,
        seed=seed, sample_rate=_with_unit(sample_rate, "Hz"), duration=_with_unit(duration, "s"),
    )  # fmt: skip


@app.command
def tune(
    study: Path | None = None,
    /,
    *,
    dies: int | None = None,
    seed: int | None = None,
    out: Path = Path("tune-out"),
    json: Path | None = None,
) -> None:
    """Gains, noises and bandwidths by gradient through the closed loop.

    Prints what moved and what has no effect, and the error of unseen dies
    before and after; warns where the gains absorb an error of the model.

    Args:
        study: a study file (TOML); its section [tune] says what is free.
        dies: how many unseen dies are reported, as in a sweep.
        seed: of the dies and of their noise.
        out: folder for tuned.toml (a study file for sweep and simulate) and tuning.json.
        json: another place for a copy of tuning.json.
    """
    from memsgyro_jax.base.runtime import configure

    configure()
    from .commands.tune import run

    run(study, out, json, dies=dies, seed=seed)


@app.command
def identify(
    *sweeps: Path,
    method: Literal["likelihood", "ratio"] = "likelihood",
    mass: float | None = None,
    amplitude_noise: float | None = None,
    phase_noise: float | None = None,
    effects: Annotated[tuple[str, ...], cyclopts.Parameter(consume_multiple=True)] = (),
    drive_axis: Literal["x", "y"] | None = None,
    conjugated: _Flag = False,
    json: Path | None = None,
    report: Path | None = None,
) -> None:
    """Coupling errors of a frequency sweep, with uncertainty and a verdict.

    The CSV has the columns "f [Hz]" and, for both channels,
    "Vx_I [V]", "Vx_Q [V]", "Vy_I [V]", "Vy_Q [V]", or
    "Vx_amp [1]", "Vx_phase [deg]", "Vy_amp [1]", "Vy_phase [deg]".
    "F_x [N]" or "F_y [N]" is the drive level and names the driven electrode.
    Phasors follow e^{+iwt}.

    Args:
        sweeps: one or several CSV files of one device, with the x electrode, the y electrode or each of them driven.
        method: maximum likelihood on both complex responses, or the published least squares on their ratio.
        mass: of the mode in kg; without it c_xy and k_xy are per unit mass.
        amplitude_noise: relative, peak to peak; without it the noise is estimated from neighbouring points.
        phase_noise: in degrees, peak to peak.
        effects: also model electrical_feedthrough, finite_sweep_rate.
        drive_axis: the driven electrode of files without `F_x` and `F_y`.
        conjugated: the file follows e^{-iwt}.
        json: file for the machine-readable result.
        report: file for a page with the curves, the fit and the residual.
    """
    from memsgyro_jax.base.runtime import configure

    configure()
    from .commands.identify import run

    run(
        sweeps,
        method=method,
        mass=mass,
        amplitude_noise=amplitude_noise,
        phase_noise=phase_noise,
        effects=effects,
        drive_axis=drive_axis,
        conjugated=conjugated,
        json=json,
        report=report,
    )


@app.command
def effects(own: Path | None = None, /, *, json: Path | None = None) -> None:
    """The catalogue of physical effects: name, unit of the strength, variants, law and reference.

    Args:
        own: a Python file with effects of your own, checked and listed behind the catalogue. It is run: trust it first.
        json: file for the machine-readable list.
    """
    from memsgyro_jax.base.runtime import configure

    configure()
    from .commands.effects import run

    run(own, json)


@app.command
def check(
    case: Path,
    /,
) -> None:
    """What a measurement case holds, how good it is, and what it can identify.

    Prints the experiments, their noise and their largest readings.
    Warns of rows that stand alone, of noise that is not the declared one,
    and of records too short for the device. Says to how many per cent
    each record would hold each parameter of the base model, and which not at all.

    Args:
        case: folder with a case.toml and the CSV files that it names.
    """
    from memsgyro_jax.base.runtime import configure

    configure()
    from .commands.check import run

    run(case)


@app.command
def compare(
    case: Path,
    /,
    *,
    model: Path | None = None,
    effects: Path | None = None,
    json: Path | None = None,
) -> None:
    """Where a model fails to explain a measurement case.

    Prints the error of every experiment over its noise, then each failure:
    experiment, drive level, temperature or time, frequency, channel.

    Args:
        case: folder with a case.toml and the CSV files that it names.
        model: a model file, taken as it is; without it the base model is fitted.
        effects: a Python file with effects of your own that the model has. It is run: trust it first.
        json: file for the machine-readable result.
    """
    from memsgyro_jax.base.runtime import configure

    configure()
    from .commands.compare import run

    run(case, model, json, effects)


@app.command
def fit(
    case: Path,
    /,
    *,
    add: Annotated[tuple[str, ...], cyclopts.Parameter(consume_multiple=True)] = (),
    effects: Path | None = None,
    out: Path | None = None,
    json: Path | None = None,
) -> None:
    """Fit a model with named effects to a measurement case.

    Prints the error of every experiment before and after, also of those that are not fitted.

    Args:
        case: folder with a case.toml and the CSV files that it names.
        add: names of effects, each with its variant ("cubic_stiffness x") or alone for all its variants.
        effects: a Python file with effects of your own. It is run: trust it first.
        out: file for the fitted model, for `memsgyro compare --model`.
        json: file for the machine-readable result.
    """
    from memsgyro_jax.base.runtime import configure

    configure()
    from .commands.fit import run

    run(case, add, out, json, effects)


@app.command
def diagnose(
    case: Path,
    /,
    *,
    model: Path | None = None,
    effects: Path | None = None,
    level: float = 0.05,
    out: Path | None = None,
    json: Path | None = None,
    report: Path | None = None,
) -> None:
    """Which physics is missing from the model of a measurement case, or that none is.

    Prints a verdict, the effects that the model needs with their strengths,
    how far the error falls, also on records that are not fitted,
    and what to measure next where these records cannot tell.

    Args:
        case: folder with a case.toml and the CSV files that it names, or the word demo for the one that comes along.
        model: a model file to start from, with the effects it has; without it the base model is fitted.
        effects: a Python file with effects of your own, tried beside the catalogue. It is run: trust it first.
        level: probability that an effect is reported where none is missing.
        out: file for the fitted model, for `memsgyro compare --model`.
        json: file for the machine-readable result.
        report: file for a page with the ranking, the curves and the residual.
    """
    from memsgyro_jax.base.runtime import configure

    configure()
    from .commands.diagnose import run

    run(case, model, effects, out, json, report, level)


def _with_unit(number: float | None, unit: str) -> dict[str, object] | None:
    """A number of the command line as a study file would hold it."""
    return None if number is None else {"value": number, "unit": unit}


if __name__ == "__main__":
    main()
