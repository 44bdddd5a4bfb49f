"""What turns what a field is given into what it holds, and names the field in what it refuses."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import DTypeLike

from .concrete import held
from .errors import InputError
from .text import excerpt


class FieldConverter:
    """The converter of one field, by `convert`, a function of the converter itself and of what the field is given.

    `Displayed` says `called` when a class is made, so that a sentence names the argument: `what` begins one about the
    field, `each` one about its entries.
    """

    def __init__(self, convert: Callable[["FieldConverter", Any], Any]) -> None:
        self._owner: type | None
        self._convert, self.what, self.each, self._owner = convert, "A number", "Each number", None

    def called(self, name: str, owner: type) -> None:
        """The field is `name` of the class `owner`."""
        self.what, self.each, self._owner = f"Argument `{name}`", f"Each entry of argument `{name}`", owner

    @property
    def unit(self) -> str:
        """The unit that the class of the field itself states, as effects do; empty where it states none."""
        return "" if self._owner is None else str(vars(self._owner).get("unit", ""))

    def __call__(self, given: Any) -> Any:
        return self._convert(self, given)


def as_array(what: str, given: Any, unit: str = "", dtype: DTypeLike | None = None) -> jax.Array:
    """`given`, which must be numbers in `unit` (SI where empty), as an array; raises `InputError` where it is not."""
    if isinstance(given, jax.Array) and dtype is None:
        return given
    try:
        return held(given) if type(given) is float and dtype is None else jnp.asarray(given, dtype)
    except (TypeError, ValueError, OverflowError) as error:
        raise InputError(
            f"{what} must be a number in {unit or 'SI'}, but is {excerpt(given)} of type {type(given).__name__}."
        ) from error
