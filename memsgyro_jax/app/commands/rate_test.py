"""`memsgyro rate-test`: read a test on a rate table, print the gyro's figures, write."""

from pathlib import Path
from typing import TYPE_CHECKING

from memsgyro_jax.base.errors import InputError

from .quick import look_for_study


if TYPE_CHECKING:
    from memsgyro_jax.measurement.beside_lot import BesideLot
    from memsgyro_jax.measurement.scale_factor_result import ScaleFactorTest


def rate_test_command(
    log: Path,
    /,
    *,
    rate_column: str | None = None,
    output_column: str | None = None,
    settle: float | None = None,
    full_scale: float | None = None,
    study: Path | None = None,
    dies: int = 16,
    effects: Path | None = None,
    json: Path | None = None,
    plot: Path | None = None,
) -> None:
    """Scale factor test of a gyro on a rate table, in the terms of IEEE 1431.

    The CSV is a raw log with columns such as "t [s]", "table rate [deg/s]"
    and "output [V]" (deg/s, V, LSB, any unit), whose plateaus are found, or
    has one row a plateau. "output std [V]", "T [degC]", "V_bias [V]",
    "run [1]" and "direction [1]" are used where they are there.
    Prints scale factor, zero-rate output, nonlinearity and its shape,
    asymmetry, hysteresis, drift, repeatability and temperature
    sensitivities with 95 % intervals, or why the test cannot tell them.

    Args:
        log: CSV file.
        rate_column: the column of the table's rate, where names do not tell it.
        output_column: the column of the gyro's output, where names do not tell it.
        settle: seconds to leave out at the begin of each plateau; without it as long as the log shows.
        full_scale: in deg/s, of which nonlinearity is told; without it the greatest rate of the test.
        study: a study file (TOML) whose lot is run at the same rates and laid beside.
        dies: how many of it, at least 3.
        effects: a Python file with effects of your own that the study names. It is run: trust it first.
        json: file for the machine-readable result.
        plot: file for a picture of the deviation from the line, SVG, PNG or PDF by its name.
    """
    look_for_study(study, log, effects)
    from .options import require_writable, writing

    require_writable(json, plot)
    import math

    from memsgyro_jax.base.files import write_json
    from memsgyro_jax.measurement.scale_factor import scale_factor_test

    result = scale_factor_test(
        log, rate_column=rate_column, output_column=output_column, settle=settle,
        full_scale=None if full_scale is None else math.radians(full_scale),
    )  # fmt: skip
    print(result)
    lot = None if study is None else _lot(result, study, effects, dies)
    if lot is not None:
        print(f"\n{lot}")
    if json is not None:
        write_json(json, result.to_dict() if lot is None else {**result.to_dict(), "beside_lot": lot.to_dict()})
    if plot is not None:
        from matplotlib.figure import Figure

        figure = Figure(figsize=(7.0, 4.2), layout="constrained")
        (result if lot is None else lot).plot(figure.subplots())
        try:
            with writing(plot, "make room and run again"):
                figure.savefig(plot)
        except ValueError as error:
            raise InputError(f"{plot}: a picture must be .svg, .png or .pdf ({error}).") from error


def _lot(test: "ScaleFactorTest", study: Path, effects: Path | None, dies: int) -> "BesideLot":
    """The lot of a study beside the test."""
    from memsgyro_jax.measurement.beside_lot import beside_lot

    from .options import chosen_study
    from .progress import told

    chosen, notes = chosen_study(study, None, effects)
    for note in notes:
        print(note)
    run = chosen.sweep_arguments
    names = ("loop", "spread", "scenario", "sample_rate", "duration", "settle", "seed")
    with told() as tell:
        return beside_lot(test, **{name: run[name] for name in names}, dies=dies, progress=tell)
