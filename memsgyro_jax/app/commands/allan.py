"""`memsgyro allan`: read a rate log, print its noise terms, write."""

from pathlib import Path

from memsgyro_jax.base.errors import InputError


def allan_command(
    log: Path,
    /,
    *,
    rate: float | None = None,
    column: str | None = None,
    start: float = 0.0,
    band: tuple[float, float] | None = None,
    json: Path | None = None,
    plot: Path | None = None,
) -> None:
    """Allan deviation of a rate log, and the noise terms of IEEE 952.

    The CSV has columns such as "t [s]" and "rate_z [deg/h]", in any unit
    of time and angular rate; each column of a rate is a series.
    Prints angle random walk N, flicker B, rate random walk K, ramp R and
    quantisation Q with their 95 % intervals, or that the record cannot
    tell them, the angle random walk at 1 s, and the bias instability.

    Args:
        log: CSV file.
        rate: sample rate in Hz; for a file without times, or one whose times jitter.
        column: the column of a rate to take, without it all; like "Gyr_X [rad/s]" where the file has no unit.
        start: seconds to leave out at the beginning.
        band: shortest and longest averaging time of the fit in s.
        json: file for the machine-readable result.
        plot: file for a picture of the deviation, SVG, PNG or PDF by its name.
    """
    from memsgyro_jax.base.files import write_json
    from memsgyro_jax.measurement.allan import allan

    from .options import require_writable

    require_writable(json, plot)
    result = allan(log, sample_rate=rate, column=column, start=start, band=band)
    print(result)
    if json is not None:
        write_json(json, result.to_dict())
    if plot is not None:
        from matplotlib.figure import Figure

        from .options import writing

        figure = Figure(figsize=(7.0, 4.2), layout="constrained")
        result.plot(figure.subplots())
        try:
            with writing(plot, "make room and run again"):
                figure.savefig(plot)
        except ValueError as error:
            raise InputError(f"{plot}: a picture must be .svg, .png or .pdf ({error}).") from error
