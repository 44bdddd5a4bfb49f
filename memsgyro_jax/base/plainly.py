"""Programs that run seldom: not worth optimising, or one in place of many that are hardly worth compiling."""

import functools
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import numpy as np


PLAINLY = {"xla_backend_optimization_level": 0}  # for the compiler


def plainly(function: Callable[..., Any]) -> Any:
    """`eqx.filter_jit` without the compiler's optimisations, which are half of its time: for what runs a few times.

    Results differ from those of an optimised program by rounding. Such a program cannot be part of another one: JAX
    takes a compiler's options for the whole alone.
    """
    # The stubs do not know the keywords of `jax.jit`.
    return eqx.filter_jit(function, compiler_options=PLAINLY)  # type: ignore[call-overload]


def at_once(function: Callable[..., Any]) -> Any:
    """A function of arrays as one program where it is called by itself, in place of one for each of its operations;
    inside another program it is part of that, as it stands.

    Numbers that are not whole count as arrays, whole ones are structure. What it does cannot depend on their values.
    """
    program = eqx.filter_jit(function, inline=True)  # type: ignore[call-overload]  # as in `plainly`

    @functools.wraps(function)
    def call(*arguments: Any, **named: Any) -> Any:
        arguments, named = jax.tree.map(_as_array, (arguments, named))
        return program(*arguments, **named)

    return call


def _as_array(leaf: Any) -> Any:
    return np.asarray(leaf) if isinstance(leaf, float | complex) else leaf
