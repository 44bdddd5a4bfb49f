"""Whether a function is affine in its arguments, or constant, by what it computes and not by values that were tried."""

from collections.abc import Callable, Sequence
from enum import IntEnum
from typing import Any

import jax
import jax.numpy as jnp
from jax.extend.core import ClosedJaxpr, Jaxpr, JaxprEqn, Literal


class _Kind(IntEnum):
    """How a part of a program depends on the arguments."""

    CONSTANT = 0
    AFFINE = 1
    OTHER = 2


# Operations that are linear in some of their operands, by the names that JAX gives them.
_IN_ALL = frozenset(
    (
        "add", "add_any", "broadcast_in_dim", "complex", "concatenate", "copy", "cumsum", "expand_dims", "imag", "neg",
        "pad", "real", "reduce_sum", "reshape", "rev", "slice", "squeeze", "stack", "sub", "transpose",
    )
)  # fmt: skip
_IN_ANY_ONE = frozenset(("mul", "dot_general"))
_IN_PLACES = {
    "div": (0,),
    "dynamic_slice": (0,),
    "dynamic_update_slice": (0, 1),
    "gather": (0,),
    "scatter": (0, 2),
    "scatter-add": (0, 2),
}


def is_affine(function: Callable[..., Any], *arguments: Any) -> bool:
    """Whether `function` of arrays is a constant plus something linear in all of them, whatever else it closes over.

    A yes is certain. A no may mean that it is affine by an operation that is not known here, or by what its numbers
    are.
    """
    return _kind_of(function, arguments) < _Kind.OTHER


def is_constant(function: Callable[..., Any], *arguments: Any) -> bool:
    """Whether `function` takes no notice of any of its arguments; as certain as `is_affine`."""
    return _kind_of(function, arguments) == _Kind.CONSTANT


def _kind_of(function: Callable[..., Any], arguments: Sequence[Any]) -> _Kind:
    program = jax.make_jaxpr(function)(*(jnp.zeros_like(argument) for argument in arguments)).jaxpr
    return max(_kinds(program, [_Kind.AFFINE] * len(program.invars)), default=_Kind.CONSTANT)


def _kinds(program: Jaxpr, given: Sequence[_Kind]) -> list[_Kind]:
    """What the results of a program are, by what its arguments are."""
    known = dict(zip(program.invars, given, strict=True))

    def kind(part: Any) -> _Kind:
        return _Kind.CONSTANT if isinstance(part, Literal) else known.get(part, _Kind.CONSTANT)

    for step in program.eqns:
        known.update(zip(step.outvars, _of_step(step, [kind(part) for part in step.invars]), strict=True))
    return [kind(part) for part in program.outvars]


def _of_step(step: JaxprEqn, given: list[_Kind]) -> list[_Kind]:
    name, highest = step.primitive.name, max(given, default=_Kind.CONSTANT)
    if name in ("jit", "pjit", "closed_call"):
        inner = step.params.get("jaxpr", step.params.get("call_jaxpr"))
        return _kinds(inner.jaxpr if isinstance(inner, ClosedJaxpr) else inner, given)
    if highest != _Kind.AFFINE:
        return [highest] * len(step.outvars)
    moving = [place for place, one in enumerate(given) if one == _Kind.AFFINE]
    if name in _IN_ANY_ONE:
        linear = len(moving) == 1
    elif name == "convert_element_type":
        linear = jnp.issubdtype(step.params["new_dtype"], jnp.inexact)
    elif name == "select_n":
        linear = 0 not in moving
    else:
        linear = name in _IN_ALL or set(moving) <= set(_IN_PLACES.get(name, ()))
    return [_Kind.AFFINE if linear else _Kind.OTHER] * len(step.outvars)
