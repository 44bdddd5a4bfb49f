"""What a person passes to a public function: quantities as numbers or as text with a unit, counts and seeds."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import DTypeLike

from .concrete import is_concrete
from .converter import FieldConverter, as_array
from .errors import InputError
from .text import excerpt


LARGEST = {"seed": 2**63 - 1}
_LARGEST = 2**31 - 1  # dies are told apart by words of 32 bits


def quantity(name: str, given: Any, unit: str) -> float:
    """Argument `name` in the SI unit `unit`: a number is in it already, text such as "100 kHz" is converted.

    Raises `InputError` for text without a unit or with one of another kind, and for what is neither.
    """
    if isinstance(given, str):
        return _read(f"Argument `{name}`:", given, unit)
    if isinstance(given, bool) or not isinstance(given, float | int | np.generic | np.ndarray | jax.Array):
        raise InputError(
            f'Argument `{name}` must be a number in {unit}, or text with a unit such as "1 {unit}", but is '
            f"{excerpt(given)} of type {type(given).__name__}."
        )
    return given  # type: ignore[return-value]


def quantities(name: str, given: Any, unit: str) -> np.ndarray:
    """`quantity` of one or several, (n,)."""
    many = given if isinstance(given, list | tuple) else [given] if isinstance(given, str) else np.atleast_1d(given)
    return np.asarray([quantity(name, one, unit) for one in many], float)


def check_kind(name: str, given: object, kind: type, what: str) -> None:
    """Raise `InputError` unless argument `name` is an instance of `kind`, in words `what`."""
    if not isinstance(given, kind):
        raise InputError(f"Argument `{name}` must be {what}, but is of type {type(given).__name__}.")


def plain_quantity(name: str, given: Any, unit: str) -> float:
    """`quantity` of what decides the structure of a program (how many samples it runs): no traced number."""
    refuse_traced(f"Argument `{name}` decides how many samples the program runs, so it", "a plain number", given)
    return quantity(name, given, unit)


def refuse_traced(what: str, instead: str, *given: Any) -> None:
    """Raise `InputError` where a transformation of JAX traces a number of `given`."""
    if not is_concrete(*given):
        raise InputError(f"{what} cannot go through jax.grad, jax.jvp, jax.vmap or jax.jit: give {instead}.")


def _read(what: str, given: str, unit: str) -> float:
    from .quantity import In  # takes half a second that numbers need not

    try:
        return In(unit).read(given)
    except ValueError as error:
        raise InputError(f"{what} {str(error).rstrip('.')}.") from error


def in_unit(unit: str, dtype: DTypeLike | None = None, *, optional: bool = False) -> FieldConverter:
    """The converter of a field that is held as an array in the SI unit `unit` ("" where that follows from its use), or,
    if `optional`, None.

    Numbers pass, text such as "100 kHz" is converted. It raises `InputError` for other text, and for what is no number.
    """

    def convert(field: FieldConverter, given: Any) -> Any:
        return None if optional and given is None else number_in(field.what, given, unit, dtype)

    return FieldConverter(convert)


def number_in(what: str, given: Any, unit: str, dtype: DTypeLike | None = None) -> jax.Array:
    """`given` as an array in the SI unit `unit` ("" where that follows from its use), as `in_unit` takes it; `what` is
    its name in a message.
    """
    if isinstance(given, str) and not unit:
        raise InputError(f"{what}, whose unit follows from its use, must be a number in SI, but is {excerpt(given)}.")
    return as_array(what, _read(f"{what}:", given, unit) if isinstance(given, str) else given, unit, dtype)


def whole(name: str, given: Any, least: int = 0) -> int:
    """Argument `name` as a whole number from `least` on; traced ones and arrays pass.

    Raises `InputError` for a fraction, and for one below `least` or above 2⁶³ − 1 (seeds) or 2³¹ − 1 (counts).
    """
    if isinstance(given, jax.Array | np.ndarray) and (isinstance(given, jax.core.Tracer) or given.ndim):
        return given  # type: ignore[return-value]
    most = LARGEST.get(name, _LARGEST)
    try:
        number = int(given)
        right = not isinstance(given, bool | str | bytes) and number == given and least <= number <= most
    except (TypeError, ValueError, OverflowError):
        right = False
    if isinstance(given, int) and -_LARGEST < given < least:
        raise InputError(f"Argument `{name}` must be at least {least}, but {given} was given.")
    if not right:
        raise InputError(
            f"Argument `{name}` must be a whole number from {least} to {most}, but {excerpt(given)} was given."
        )
    return number


def arrays(unit: str = "", **options: object) -> tuple[jax.Array, ...]:
    """A field that holds a tuple of numbers, each as an array; whole numbers become real ones. With a `unit` they may
    be text such as "3 kHz".
    """
    return eqx.field(converter=FieldConverter(lambda field, given: several(field, given, unit)), **options)


def several(field: FieldConverter, given: Any, unit: str = "") -> tuple[jax.Array, ...]:
    """`given` as such a field holds it; raises `InputError` where it is no tuple of numbers."""
    if isinstance(given, str) or not np.iterable(given):
        raise InputError(
            f"{field.what} must be a tuple of numbers, `(1.0, 2.0)` say, but is {excerpt(given)} of type "
            f"{type(given).__name__}."
        )
    return jax.tree.map(lambda entry: _real(number_in(field.each, entry, unit)), tuple(given))


def _real(array: jax.Array) -> jax.Array:
    return array if jnp.issubdtype(array.dtype, jnp.inexact) else array.astype(float)


def number(unit: str = "", **options: object) -> jax.Array:
    """A field that holds a number, or one per die, as an array: traced, differentiable, no recompilation when it
    changes. With a `unit` it may be given as text in another of the same kind, such as "2.9 kHz".
    """
    return eqx.field(converter=in_unit(unit), **options)
