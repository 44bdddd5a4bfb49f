"""Programs that run too seldom to be worth optimising."""

from collections.abc import Callable
from typing import Any

import equinox as eqx


PLAINLY = {"xla_backend_optimization_level": 0}  # for the compiler


def plainly(function: Callable[..., Any]) -> Any:
    """`eqx.filter_jit` without the compiler's optimisations, which are half of its time: for what runs a few times.

    Results differ from those of an optimised program by rounding. Such a program cannot be part of another one: JAX
    takes a compiler's options for the whole alone.
    """
    # The stubs do not know the keywords of `jax.jit`.
    return eqx.filter_jit(function, compiler_options=PLAINLY)  # type: ignore[call-overload]
