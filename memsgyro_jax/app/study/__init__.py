"""Study files: the text form (TOML) of a loop, its surroundings, its spread and the settings of a sweep."""

import tomllib
from pathlib import Path

from memsgyro_jax.base.complaints import Source as _Source
from memsgyro_jax.base.errors import InputError

from .file import Study as Study
from .file import read_study as _read_study
from .record import read_rate_record as read_rate_record


def load_study(path: str | Path) -> Study:
    """Reads a study file.

    It has the sections `[device]`, `[readout]`, `[observer]`, `[controller]`, `[filter]`, `[loop]`, `[scenario]`,
    `[spread]` and `[sweep]`; one that is left out is that of `default_study()` (which has no filter), one that is given
    replaces it as a whole. Quantities
    are text with a unit, `"1.8e-7 kg"`, or `{ value = 1.8e-7, unit = "kg" }`. File names start at the study's folder.

    Raises:
        InputError: everything that is wrong with the file, each with its line and key.
    """
    path = Path(path)
    try:
        text = path.read_bytes().decode("utf-8")
        data = tomllib.loads(text)
    except FileNotFoundError as error:
        raise InputError(f"{path}: no such study file.") from error
    except OSError as error:
        raise InputError(f"{path}: the study file cannot be read ({error.strerror}).") from error
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: a study file must be text in UTF-8, but byte {error.start} is not.") from error
    except tomllib.TOMLDecodeError as error:
        raise InputError(f"{path}: a study file must be TOML, but cannot be read: {error}.") from error
    return _read_study(data, _Source(str(path), path.parent, text))


def default_study() -> Study:
    """The main job: the gyro of thesis Table 5.1 behind the read-out of Table 5.3, 256 dies of 15 % spread."""
    return _read_study({}, _Source("the default study", Path()))
