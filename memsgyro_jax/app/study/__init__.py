"""Study files: the text form (TOML) of a loop, its surroundings, its spread and the settings of a sweep."""

from collections.abc import Sequence
from pathlib import Path

from memsgyro_jax.base.complaints import Source as _Source
from memsgyro_jax.base.toml import read_toml as _read_toml
from memsgyro_jax.effects import Effect

from .file import Study as Study
from .file import read_study as _read_study
from .record import read_rate_record as read_rate_record


def load_study(path: str | Path, own: Sequence[Effect] = ()) -> Study:
    """Reads a study file.

    It has the sections `[device]`, `[process]`, `[readout]`, `[observer]`, `[controller]`, `[actuators]`, `[filter]`,
    `[loop]`, `[scenario]`, `[spread]` and `[sweep]`; one that is left out is that of `default_study()` (which has no
    filter and no limit of its actuators), one that is given replaces it as a whole. Start, tones, sampling, duration
    and prior follow the device where they are left out (`Operation`). Quantities are text with a unit,
    `"1.8e-7 kg"`, or `{ value = 1.8e-7, unit = "kg" }`. File names start at the study's folder.

    `[device]` may name the file of a fit, `file = "device.toml"`, and every `[[effects]]` adds one to the device:
    `name`, `axis` (or `variant`), `strength`.

    Args:
        path: the file.
        own: effects beyond the catalogue, from `load_effects`.

    Raises:
        InputError: everything that is wrong with the file, each with its line and key.
    """
    return _read_study(*_read_toml(path, "study file"), own)


def default_study() -> Study:
    """The main job: the gyro of thesis Table 5.1 behind the read-out of Table 5.3, 256 dies of 15 % spread."""
    return _read_study({}, _Source("the default study", Path()))
