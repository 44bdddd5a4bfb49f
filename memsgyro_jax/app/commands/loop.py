"""`memsgyro loop`: the loop of a study at its design, over frequency: Bode diagrams, margins, noise by source."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import cyclopts

from memsgyro_jax.base.errors import InputError

from .flags import Numbers
from .quick import look_for_study


if TYPE_CHECKING:
    from memsgyro_jax.loop.gain_phase import GainPhaseMargins
    from memsgyro_jax.loop.loop import ClosedLoop

SCHEMA = "memsgyro-loop/1"
Disturbance = Literal["rate", "force x", "force y", "voltage x", "voltage y"]  # `INPUTS`, known before JAX is imported
_POINTS = 24  # frequencies of a Bode diagram where none are given
_SHARE = 0.05  # of the sample rate, which none of these exceeds
_PERIODS = 20.0  # of the frequency at half the power, in which the lowest one has its period


def loop_command(
    study: Path | None = None,
    /,
    *,
    disturbance: Annotated[tuple[Disturbance, ...], cyclopts.Parameter(consume_multiple=True)] = ("rate",),
    frequencies: Numbers = (),
    duration: str | None = None,
    level: float = 0.0,
    report: Path | None = None,
    effects: Path | None = None,
    json: Path | None = None,
) -> None:
    """A loop over frequency: Bode diagrams, margins, noise by source.

    The response of the rate that is given out to a small sine of the rate, or of
    the amplitude of a force or voltage beside the swing, with its bandwidth; gain
    and phase margins of a classic loop; and what the noise of the rate comes
    from. All of the design, without spread.

    Args:
        study: a study file (TOML); without it the loop of the thesis.
        disturbance: what the sine is of, one or several: the rate, a force on the mass, a voltage of the read-out.
        frequencies: of the sines in Hz, rising, from one period of the settled part on: `--duration` sets this lowest
            one (2/duration, without `settle`). Without them 24 from there to half the drive's frequency, and some at
            the split of the modes.
        duration: of the runs in s or with a unit; without it the study's own, or as long as a classic loop takes to
            come to rest. A longer one allows lower frequencies.
        level: the constant rate in deg/s around which the loop is looked at.
        report: file for a page with the diagrams.
        effects: a Python file with effects of your own that the study names. It is run: trust it first.
        json: file for the machine-readable result.
    """
    look_for_study(study, effects)
    import numpy as np

    from memsgyro_jax.base.files import write_json
    from memsgyro_jax.loop.frequency_response import check_frequencies, frequency_response
    from memsgyro_jax.loop.further import around_split
    from memsgyro_jax.loop.noise_budget import noise_budget

    from .options import chosen_study, require_writable, with_unit, writing
    from .progress import told

    chosen, notes = chosen_study(study, None, effects, duration=with_unit(duration, "s"))
    require_writable(report, json)
    for note in notes:
        print(note)
    run = chosen.settings.numbers()
    runs = {name: run[name] for name in ("sample_rate", "duration")}
    runs["settle"] = run.get("settle") or 0.5 * runs["duration"]
    runs = runs if duration else _rested(chosen.loop, runs)
    low = 1.0 / (runs["duration"] - runs["settle"])  # a period
    if frequencies:
        check_frequencies(np.asarray(frequencies, float), runs["sample_rate"], runs["duration"] - runs["settle"])
    answers = []
    with told() as tell:
        tell("margins and noise")
        margins, noise = _margins(chosen.loop), noise_budget(chosen.loop, sample_rate=runs["sample_rate"])
        high = min(_SHARE * runs["sample_rate"], 0.5 * float(noise.swing))
        at = frequencies or np.union1d(np.geomspace(low, high, _POINTS), around_split(chosen.loop.device, low, high))
        for name in disturbance:
            tell(f"response to {name}")
            carrier = None if name == "rate" else float(noise.swing)  # slow ones do not reach the rate
            about = {"level": float(np.radians(level)), "carrier": carrier}
            answers.append(frequency_response(chosen.loop, at, name, **runs, **about))
    print("\n\n".join(str(part) for part in (*answers, margins, noise) if part is not None))
    with writing(report or json or Path(), "make room and run again"):
        if report is not None:
            from ..report.loop_pages import loop_page

            print(f"\n{loop_page(chosen, answers, margins, noise).save(report)} is the page.")
        if json is not None:
            told_margins = None if margins is None else margins.as_dict()
            missing = [] if margins is None else list(margins.left_out)
            told_answers = {answer.disturbance: answer.as_dict() for answer in answers}
            write_json(
                json,
                {
                    "schema": SCHEMA,
                    "responses": told_answers,
                    "margins": told_margins,
                    "margins_leave_out": missing,
                    "noise": noise.as_dict(),
                },
            )


def _rested(loop: "ClosedLoop", runs: dict[str, float]) -> dict[str, float]:
    """The numbers of runs whose loop has come to rest where they begin to count; where they change, it is said."""
    from memsgyro_jax.loop.further import expected_half_power
    from memsgyro_jax.loop.settling import duration_to_settle, not_at_rest

    if not not_at_rest(loop, runs["settle"], runs["duration"]):
        return runs
    enough = duration_to_settle(loop, runs["settle"], runs["duration"])
    rested, window = enough * runs["settle"] / runs["duration"], runs["duration"] - runs["settle"]
    if half := expected_half_power(loop):  # what counts may be shorter than what has passed
        enough = min(enough, float(f"{rested + max(window, _PERIODS / half):.3g}"))
    print(
        f"Runs of {enough:g} s, in which the loop comes to rest: the {runs['duration']:.3g} s of the study would show "
        "its start (`--duration` sets another)."
    )
    return {**runs, "duration": enough, "settle": rested}


def _margins(loop: "ClosedLoop") -> "GainPhaseMargins | None":
    """Those of a loop in classic control; None of another."""
    from memsgyro_jax.loop.gain_phase import gain_phase_margins

    try:
        return gain_phase_margins(loop)
    except InputError:
        return None
