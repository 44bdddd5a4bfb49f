"""Fields of objects as type checkers are told of them, which know neither equinox's abstract fields nor its converters.

`AbstractVar[X]` declares what a subclass must have; for a checker it is no field of the base, so that the arguments of
a member stand in its own order. `Scalar` is a number, or one per die: a field turns what it is given into an array, so
that either is welcome.
"""

from typing import TYPE_CHECKING, Any, TypeAlias


if TYPE_CHECKING:
    from typing import ClassVar as AbstractVar

    Scalar: TypeAlias = Any
else:
    from equinox import AbstractVar as AbstractVar
    from jaxtyping import Array, Float

    Scalar = Float[Array, "*lanes"]
