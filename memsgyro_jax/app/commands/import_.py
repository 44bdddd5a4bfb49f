"""`memsgyro import`: read what instruments save, write a measurement case, print what was assumed."""

from pathlib import Path
from typing import Annotated

import cyclopts

from .flags import Flag, Words


def import_command(
    *files: Path,
    out: Path,
    map_: Annotated[tuple[str, ...], cyclopts.Parameter(name="--map", consume_multiple=True)] = (),
    drive: Words = (),
    axis: Words = (),
    reference: str = "",
    sample_rate: str = "",
    bias: Words = (),
    temperature: Words = (),
    every: int | None = None,
    rms: Flag = False,
    overwrite: Flag = False,
    json: Path | None = None,
) -> None:
    """What instruments save, as case files that say what was assumed.

    Reads text tables (any delimiter, decimal point or comma), Zurich Instruments'
    CSV, HDF5 and MAT, touchstone s1p and s2p, LabVIEW lvm and TDMS, and
    universal files. Prints what was assumed, which case.toml holds as well.

    Args:
        files: one or several of one device.
        out: folder of the case.
        map_: what columns mean where names do not tell, like "f=Frequency (Hz),x_I=X [V],x_Q=Y [V],F_x=drive [A]";
            one for all files or one for each, "-" for a file whose names tell.
        drive: level where no column has it, like "20 mV"; one for all files or one for each, "-" for a file that needs
            none, as a ring-down.
        axis: which axis was driven, x or y, where two channels were read and neither a column F_x, F_y nor the name of
            file or folder (drive_x) says it; one for all files or one for each, "-" for one that says it.
        reference: frequency of a lock-in that recorded over time, or operating points, like "32.768 kHz".
        sample_rate: of waveforms without a column of time where the file does not tell it, like "50 kHz".
        bias: voltage of the electrodes where no column has it, like "20 V"; one for all files or one for each, "-" for
            a file of which nothing is said.
        temperature: like "25 degC", as the bias.
        every: keep one row of so many, waveforms behind a low pass, phasors over time as means: for records longer than
            they need to be. Left out, a long ringing of phasors becomes such means, and all else stays.
        rms: the readings of a lock-in are effective values, not peak ones, where their unit does not say; the drive
            stays as it is. Of one file among several say it in its map, "x_amp=R [Vrms]".
        overwrite: write over a case that is there.
        json: file for the machine-readable result.
    """
    from memsgyro_jax.base.files import write_json
    from memsgyro_jax.measurement.import_case import import_case

    from .options import require_writable
    from .progress import told

    require_writable(json)
    # Without what kept a dash from an option.
    levels, maps, tuned = [level.strip() for level in drive], [one.strip() for one in map_], reference.strip()
    held = {"bias": [one.strip() for one in bias], "temperature": [one.strip() for one in temperature]}
    with told() as tell:
        tell(f"reading {len(files)} file{'s' * (len(files) > 1)}, and what device their records show")
        result = import_case(
            files,
            out,
            columns=maps,
            drive=levels,
            axis=[one.strip() for one in axis],
            reference=tuned,
            sample_rate=sample_rate.strip(),
            **held,
            every=every,
            rms=rms,
            overwrite=overwrite,
        )
    print(result)
    if not result.warning:
        print(f"Next: `memsgyro check {out}`, then `memsgyro diagnose {out}`.")
    if json is not None:
        write_json(json, result.to_dict())
