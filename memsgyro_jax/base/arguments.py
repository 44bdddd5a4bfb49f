"""What a person passes to a public function: quantities as numbers or as text with a unit, counts and seeds."""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from .concrete import is_concrete
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


def in_unit(unit: str) -> Callable[[Any], Any]:
    """The converter of a field that is held as an array in the SI unit `unit` ("" where that follows from its use).

    Numbers pass, text such as "100 kHz" is converted. It raises `InputError` for other text.
    """

    def convert(given: Any) -> Any:
        if not isinstance(given, str):
            return jnp.asarray(given)
        if not unit:
            raise InputError(f"A number whose unit follows from its use must be given in SI, but is {excerpt(given)}.")
        return jnp.asarray(_read("A number", given, unit))

    return convert


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


def number(unit: str = "", **options: object) -> jax.Array:
    """A field that holds a number, or one per die, as an array: traced, differentiable, no recompilation when it
    changes. With a `unit` it may be given as text in another of the same kind, such as "2.9 kHz".
    """
    return eqx.field(converter=in_unit(unit), **options)
