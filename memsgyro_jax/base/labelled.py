"""Results as people take them along: a Dataset of xarray with units and names, and one file that any tool reads.

A result says only which arrays it has (`to_xarray`); that they are text, numbers with units that pint reads, and plain
attributes, is seen to here, and so is the file.
"""

import abc
import shutil
import uuid
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from .display import Shown
from .errors import InputError
from .files import write_whole
from .labels import plain_attributes, with_labels
from .units import without_roots


if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr

MARK = "memsgyro"  # attribute: the name of the class of a result
_ZARR = ".zarr"
_OTHERS = (".csv", ".h5", ".hdf5", ".html", ".json", ".mat", ".npz", ".parquet", ".pickle", ".pkl", ".toml", ".txt")
_LARGEST = 2**31 - 4  # bytes of a variable of NetCDF 3


class Labelled(Shown, abc.ABC):
    """A result with a Dataset, which it keeps in files."""

    @abc.abstractmethod
    def to_xarray(self) -> "xr.Dataset":
        """Everything in numbers and text, with `units` that pint reads and a `long_name`."""

    def save(self, path: str | Path) -> Path:
        """Writes `to_xarray()` whole or not at all: NetCDF, or zarr where the name ends in `.zarr`; `mg.load` reads it.

        What an earlier `save` wrote there is replaced.

        **Raises:** `InputError` where something else lies at the path, for the ending of another format, or for more
        than NetCDF 3 holds.
        """
        path = Path(path)
        if path.suffix in _OTHERS:
            raise InputError(f"{path} must end in .nc or .zarr, which results are kept in, not in {path.suffix}.")
        data = self.to_xarray()
        if path.suffix == _ZARR:
            return _write_zarr(path, data)
        for name, variable in data.variables.items():
            if variable.nbytes > _LARGEST:
                raise InputError(
                    f"{path} must end in `.zarr`, because NetCDF 3 holds 2 GiB of a variable at most, but `{name}` "
                    f"has {variable.nbytes / 2**30:.3g} GiB."
                )
        # SciPy writes it, which is here anyway: the libraries of NetCDF 4 are as large as this package.
        return write_whole(path, bytes(data.to_netcdf(None, engine="scipy", format="NETCDF3_64BIT")))


class Tabular(Labelled):
    """A result that is a table along one dimension of its Dataset."""

    along: ClassVar[str]

    def to_pandas(self) -> "pd.DataFrame":
        """The table: a row each along the dimension, and columns "name label" where an array has one more."""
        data, columns = self.to_xarray(), {}
        for name, held in data.variables.items():
            others = [dimension for dimension in held.dims if dimension != self.along]
            if self.along not in held.dims or name == self.along or len(others) > 1:
                continue
            if not others:
                columns[name] = held.values
            elif others[0] in data.coords:
                each = data[name].transpose(self.along, others[0]).values.T
                columns |= {f"{name} {label}": one for label, one in zip(data[others[0]].values, each, strict=True)}
        if not columns and data.variables:
            raise InputError(
                f"A table has one row for each {self.along}, but this {type(self).__name__} holds several runs; take "
                "`to_xarray()`, or one run of it."
            )
        import pandas as pd

        index = data[self.along].values if self.along in data.coords else range(data.sizes[self.along])
        return pd.DataFrame(columns, pd.Index(index, name=self.along))


def columns_of(dimension: str, rows: Sequence[Any], **units: str | None) -> dict[str, tuple]:
    """Variables along a dimension, one for each of the named fields of `rows`, with its unit."""
    return {name: (dimension, [getattr(row, name) for row in rows], unit) for name, unit in units.items()}


def labelled(
    result: object,
    variables: Mapping[str, tuple],
    coordinates: Mapping[str, Any],
    attributes: Mapping[str, Any] | None = None,
) -> "xr.Dataset":
    """The Dataset of a result.

    Args:
        result: whose class and printed form stand in the attributes.
        variables: name to dimensions, values, unit and, where the name does not say it, a long name; the unit is None
            for text, and for numbers whose units differ and stand in a coordinate.
        coordinates: the same, or only the labels along the dimension of that name.
        attributes: further ones; what is no number or text becomes JSON, and None is left out.
    """
    import xarray as xr

    about = {MARK: type(result).__name__, "printed": str(result), **(attributes or {})}
    return xr.Dataset(
        {name: _variable(name, *held) for name, held in variables.items()},
        {
            name: _variable(name, *(held if isinstance(held, tuple) else (name, held, None)))
            for name, held in coordinates.items()
        },
        plain_attributes(about),
    )


def load(path: str | Path) -> "xr.Dataset":
    """What `save` wrote, as the Dataset that `to_xarray` gave; its attribute `printed` is the result as it prints.

    The store of a sweep (`dies.zarr`, or the folder it lies in) is read too, as far as it has come: `status` says which
    dies are done.

    **Raises:** `InputError` for a file that is missing or is none of these.
    """
    import xarray as xr

    path = Path(path)
    if not path.exists():
        raise InputError(f"{path}: no such file; `save` of a result writes one.")
    if (path / "dies.zarr").is_dir():
        path = path / "dies.zarr"
    try:
        if path.is_dir():
            data = xr.open_zarr(path, chunks=None, consolidated=False).load()
        else:
            data = xr.load_dataset(path, engine="scipy")
    except Exception as error:  # of three libraries, each with its own
        raise InputError(f"{path} must be a result that was saved, but cannot be read as one.") from error
    if MARK not in data.attrs and "fingerprint" not in data.attrs:
        raise InputError(f"{path} must be a result that was saved, but says nothing of `{MARK}`; open it by xarray.")
    texts = {name: held for name, held in data.coords.items() if held.dtype.kind == "T"}  # which NetCDF does not know
    return with_labels(
        data.assign_coords({k: (held.dims, np.array(held.values.tolist())) for k, held in texts.items()})
    )


def _variable(name: str, dimensions: Any, values: Any, unit: str | None, long_name: str = "") -> tuple:
    about = {"long_name": long_name or name.replace("_", " ")}
    if name == "unit" or name.endswith("_unit"):
        values = [without_roots(each) for each in values]
    return dimensions, np.asarray(values), about if unit is None else {"units": without_roots(unit), **about}


def _write_zarr(path: Path, data: "xr.Dataset") -> Path:
    if path.exists():
        try:
            load(path)
        except InputError as error:
            raise InputError(f"{path} must be new or an earlier result, but is something else.") from error
    draft = path.with_name(f".{path.name}.{uuid.uuid4().hex}.part")
    try:
        data.to_zarr(draft, zarr_format=2)  # the third has no settled type for text yet, and warns
        shutil.rmtree(path, ignore_errors=True)
        draft.rename(path)
    finally:
        shutil.rmtree(draft, ignore_errors=True)
    return path
