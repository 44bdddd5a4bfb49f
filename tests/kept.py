"""What every result that people take along must keep in a file."""

import pint
import pytest
import xarray as xr

import memsgyro_jax as mg


_READ = pint.UnitRegistry().parse_units


def kept(result, folder) -> xr.Dataset:
    """The Dataset of a result, seen to be whole in both kinds of file, with units that pint reads as they are."""
    data = result.to_xarray()
    for name in ("kept.nc", "kept.zarr"):
        for _ in range(2):  # a second one takes the place of the first
            assert result.save(folder / name) == folder / name
        xr.testing.assert_identical(mg.load(folder / name), data)
    with pytest.raises(mg.InputError, match=r"must end in .nc or .zarr"):
        result.save(folder / "kept.json")
    assert {path.name for path in folder.glob("*kept*")} >= {"kept.nc", "kept.zarr"}
    assert not list(folder.glob(".*.part"))
    assert data.attrs["memsgyro"] == type(result).__name__
    assert data.attrs["printed"]
    assert {type(value) for value in data.attrs.values()} <= {str, int, float}
    for name, held in data.variables.items():
        assert held.attrs["long_name"], name
        stated = [held.attrs["units"]] if "units" in held.attrs else []
        stated += [str(unit) for unit in held.values] if name == "unit" or str(name).endswith("_unit") else []
        for unit in stated:
            assert "√" not in unit
            _READ(unit)
        numbers = held.dtype.kind in "fc" and "units" not in held.attrs
        along = {f"{dimension}_unit" for dimension in held.dims} | {"unit", "effect_unit"}
        assert not numbers or along & set(data.variables) or name in ("drive", "training", "validation"), name
    return data
