"""`memsgyro datasheet`: read the study, test its lot as a laboratory would, print, write."""

from pathlib import Path
from typing import TYPE_CHECKING

from .flags import Flag, Numbers
from .quick import look_for_study


if TYPE_CHECKING:
    from memsgyro_jax.measurement.datasheet_rows import Datasheet


def datasheet_command(
    study: Path | None = None,
    /,
    *,
    full_scale: float = 300.0,
    dies: int | None = None,
    seed: int | None = None,
    trim: Flag = False,
    noise_duration: float | None = None,
    temperatures: Numbers = (-40.0, 25.0, 85.0),
    out: Path = Path("datasheet.html"),
    effects: Path | None = None,
    json: Path | None = None,
) -> None:
    """The datasheet of a simulated lot, on one page.

    Zero-rate output, scale factor and non-linearity, noise density, angle
    random walk, bandwidth, start-up time, cross-axis and acceleration
    sensitivity, quadrature: minimum, typical and maximum over dies, in the
    terms of IEEE 528 and 1431. What the model cannot give says so. The page is
    there before the long run with noise, and again with it.

    Args:
        study: a study file (TOML).
        full_scale: greatest rate either way, in deg/s.
        dies: how many dies, at least 3; for a spread 30 or more.
        seed: of the dies and of their noise.
        trim: also tell the figures after each die got its own offset and scale.
        noise_duration: of the run with noise in s; without it what the bandwidth asks for.
        temperatures: in °C, at each of which the lot is held, if anything in the device depends on it.
        out: the page, an HTML file, or a folder for datasheet.html.
        effects: a Python file with effects of your own that the study names. It is run: trust it first.
        json: file for the machine-readable result.
    """
    look_for_study(study, effects)
    import numpy as np

    from memsgyro_jax.base.files import write_json, write_whole
    from memsgyro_jax.measurement.datasheet import datasheet
    from memsgyro_jax.measurement.over_temperature import CELSIUS

    from ..report.datasheet_page import datasheet_page
    from .options import chosen_study, require_writable, writing
    from .progress import told

    out = out if out.suffix and not out.is_dir() else out / "datasheet.html"
    chosen, notes = chosen_study(study, None, effects, seed=seed)
    require_writable(out, json)
    for note in notes:
        print(note)

    def write(sheet: "Datasheet") -> None:
        write_whole(out, datasheet_page(sheet, chosen).html())
        if json is not None:
            write_json(json, sheet.as_dict())

    run = chosen.sweep_arguments
    arguments = {
        name: run[name] for name in ("loop", "spread", "scenario", "sample_rate", "duration", "settle", "seed")
    }
    with writing(out, "make room and run again"):
        out.parent.mkdir(parents=True, exist_ok=True)
        with told() as tell:

            def keep(sheet: "Datasheet") -> None:
                write(sheet)
                tell(f"{out} is the page without the noise; Ctrl-C leaves it")

            found = datasheet(
                **arguments, full_scale=float(np.radians(full_scale)), dies=64 if dies is None else dies, trim=trim,
                noise_duration=noise_duration, temperatures=tuple(t + CELSIUS for t in temperatures), progress=tell,
                draft=keep,
            )  # fmt: skip
        write(found)
    print(found)
    print(f"{out} is the page.")
