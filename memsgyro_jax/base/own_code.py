"""What a user's own class does that its port or JAX does not take, in words: arguments, branches, indices."""

import inspect
import sys
import traceback
from collections.abc import Callable, Iterator
from typing import Any

import jax
import numpy as np


_PACKAGE = __name__.split(".")[0]
_UNTRACED: tuple[tuple[type[Exception], str], ...] = (
    (jax.errors.TracerBoolConversionError, "branches on a number; choose with `jax.numpy.where` instead of `if`"),
    (jax.errors.NonConcreteBooleanIndexError, "picks entries by a condition; choose with `jax.numpy.where`"),
    (jax.errors.TracerArrayConversionError, "hands a number to NumPy; call the function of that name in `jax.numpy`"),
    (jax.errors.TracerIntegerConversionError, "counts by a number; only fixed ones can be counted by or indexed with"),
    (jax.errors.ConcretizationTypeError, "makes a Python number of one; leave out `float` or `int`"),
)
_CALLS = (
    "jit",
    "pjit",
    "closed_call",
    "custom_jvp_call",
    "custom_vjp_call",
)  # a loop's numbers are not those it began with


def is_outside(kind: type) -> bool:
    """Whether a class is not of the package."""
    return kind.__module__.split(".")[0] != _PACKAGE


def untraced(error: BaseException) -> str:
    """What code does that JAX, which follows it with numbers that are not known yet, stopped at; empty for others."""
    return next((words for kind, words in _UNTRACED if isinstance(error, kind)), "")


def where_in(error: BaseException, kind: type) -> tuple[str | None, int | None]:
    """The innermost method of `kind` that an error passed through, and the line in its file; None where it did not."""
    own = [each for each in kind.__mro__ if is_outside(each) and each is not object]
    files = {getattr(sys.modules.get(each.__module__), "__file__", None) for each in own} - {None}
    frames = [frame for frame in traceback.extract_tb(error.__traceback__) if frame.filename in files]
    methods = [frame.name for frame in frames if any(frame.name in vars(each) for each in own)]
    return methods[-1] if methods else None, frames[-1].lineno if frames else None


def amiss_in_arguments(part: object, named: tuple[str, ...] = ()) -> Iterator[str]:
    """Of each method of a class from outside that cannot take what its port hands to it a sentence without its full
    stop; `named` are optional arguments that it will get by name, too.
    """
    kinds = type(part).__mro__
    own = dict.fromkeys(name for kind in kinds if is_outside(kind) and kind is not object for name in vars(kind))
    for name in own:
        kind = next((each for each in kinds if not is_outside(each) and name in vars(each)), None)
        port = None if kind is None else inspect.unwrap(getattr(kind, name))
        if not inspect.isfunction(port) or not callable(getattr(part, name)) or name.startswith(("_", "for_")):
            continue
        takes = list(inspect.signature(port).parameters.values())[1:]
        wanted = [each.name for each in takes if each.default is each.empty and each.kind is each.POSITIONAL_OR_KEYWORD]
        more = [each.name for each in takes if each.name in named]
        method = inspect.signature(getattr(part, name))
        try:
            method.bind(*wanted, **dict.fromkeys(more))
        except TypeError:
            yield (
                f"method `{name}` of {type(part).__name__} must take ({', '.join(('self', *wanted, *more))}), but "
                f"takes ({', '.join(('self', *method.parameters))})"
            )


def traced(function: Callable[..., Any], *given: Any) -> tuple[Any, str]:
    """Shapes of what `function` of arrays returns, and what it reads or writes beyond their ends, in words; empty for
    nothing. JAX takes the last entry in place of one that is not there, and drops what is written to it, unsaid.
    """
    program, shapes = jax.make_jaxpr(function, return_shape=True)(*given)
    known = dict(zip(program.jaxpr.constvars, program.consts, strict=True))
    return shapes, next(_beyond(program.jaxpr, known), "")


def _beyond(program: Any, known: dict[Any, Any]) -> Iterator[str]:
    """Sentences on the operations of a program whose places are constants; one within bounds is a plain slice."""
    for step in program.eqns:
        values = [each.val if hasattr(each, "val") else known.get(each) for each in step.invars]
        shape, name = step.invars[0].aval.shape if step.invars else (), step.primitive.name
        if inner := [p for p in jax.tree.leaves(list(step.params.values())) if hasattr(getattr(p, "jaxpr", p), "eqns")]:
            for each in inner:
                yield from _beyond(*_within(each, values if name in _CALLS else []))
        elif name == "dynamic_slice" and all(value is not None for value in values[1:]):
            yield from _outside(shape, values[1:], step.params["slice_sizes"])
        elif name.startswith(("gather", "scatter")) and values[1] is not None:
            numbers, sizes = step.params["dimension_numbers"], step.params.get("slice_sizes", (1,) * len(shape))
            axes = numbers.start_index_map if name == "gather" else numbers.scatter_dims_to_operand_dims
            for row in np.reshape(values[1], (-1, len(axes))):
                yield from _outside([shape[axis] for axis in axes], row, [sizes[axis] for axis in axes])
        elif values and len(step.outvars) == 1 and all(value is not None for value in values):
            known[step.outvars[0]] = step.primitive.bind(*values, **step.params)


def _within(program: Any, values: list[Any]) -> tuple[Any, dict[Any, Any]]:
    """A program inside another, and what is known of what it is given."""
    inner = getattr(program, "jaxpr", program)
    known = dict(zip(inner.constvars, getattr(program, "consts", ()), strict=False))
    if len(inner.invars) == len(values):
        known |= {name: value for name, value in zip(inner.invars, values, strict=True) if value is not None}
    return inner, known


def _outside(shape: Any, start: Any, size: Any) -> Iterator[str]:
    for length, first, count in zip(shape, start, size, strict=True):
        if not 0 <= int(first) <= length - count:
            yield f"reaches for entry {int(first)} of {length}, counted from 0"
