"""Small vectors and matrices of scalars, with operators: `F @ motion + B @ force` for one die or for many side by side.

They are tuples of scalars, not arrays: XLA then fuses a whole step over a batch of dies, where stacking small arrays
cost a quarter of the run time. The plain numbers 0 and 1 among the entries cost nothing: no operation is recorded for
them. Any tuple may stand where a vector or matrix is only read; a result that leaves a port is made a `tuple` again,
since what a scan carries must keep its type.
"""

from collections.abc import Callable, Iterable
from typing import Any

import jax
import numpy as np

from memsgyro_jax.base.fields import Scalar


def is_plain(value: object, number: int) -> bool:
    """Whether `value` is the plain Python number `number`, known while a program is recorded."""
    return isinstance(value, float | int) and value == number


def plus(p: Scalar, q: Scalar) -> Scalar:
    """p + q."""
    return q if is_plain(p, 0) else p if is_plain(q, 0) else p + q


def minus(p: Scalar, q: Scalar) -> Scalar:
    """p - q."""
    return p if is_plain(q, 0) else -q if is_plain(p, 0) else p - q


def times(p: Scalar, q: Scalar) -> Scalar:
    """p q."""
    if is_plain(p, 0) or is_plain(q, 0):
        return 0.0
    return q if is_plain(p, 1) else p if is_plain(q, 1) else p * q


def dot(a: Iterable[Scalar], b: Iterable[Scalar]) -> Scalar:
    """Sum of products."""
    total = 0.0
    for p, q in zip(a, b, strict=True):
        total = plus(total, times(p, q))
    return total


class _Small(tuple):
    """What vectors and matrices share: sums entry by entry, products with a scalar or entry by entry."""

    __slots__ = ()
    __array_ufunc__ = None  # a NumPy number on the left leaves the product to us
    _with: Callable[[Callable, Any], Any]

    def __add__(self, other):
        return self._with(plus, other)

    __radd__ = __add__

    def __sub__(self, other):
        return self._with(minus, other)

    def __mul__(self, other):
        return self._with(times, other)

    __rmul__ = __mul__

    def __neg__(self):
        return self * -1.0


class Vector(_Small):
    """A vector of scalars; `*` and `/` are entry by entry, `@` is the scalar product."""

    __slots__ = ()

    def __truediv__(self, other):
        return self._with(lambda p, q: p / q, other)

    def __matmul__(self, other):
        if _has_rows(other):
            return Vector(dot(self, column) for column in zip(*other, strict=True))
        return dot(self, other)

    def _with(self, operation, other):
        others = other if isinstance(other, tuple | list) else (other,) * len(self)
        return Vector(operation(p, q) for p, q in zip(self, others, strict=True))


class Matrix(_Small):
    """A matrix: rows that are vectors."""

    __slots__ = ()

    def __new__(cls, rows: Iterable[Iterable[Scalar]]):
        return rows if isinstance(rows, cls) else tuple.__new__(cls, map(Vector, rows))

    @property
    def T(self) -> "Matrix":
        """The transpose."""
        return Matrix(zip(*self, strict=True))

    def __matmul__(self, other):
        if _has_rows(other):
            columns = tuple(zip(*other, strict=True))
            return Matrix((dot(row, column) for column in columns) for row in self)
        return Vector(dot(row, other) for row in self)

    def beside(self, other: Iterable[Iterable[Scalar]]) -> "Matrix":
        """The columns of `other` to the right of these."""
        return Matrix((*left, *right) for left, right in zip(self, other, strict=True))

    def above(self, other: Iterable[Iterable[Scalar]]) -> "Matrix":
        """The rows of `other` below these."""
        return Matrix((*self, *other))

    def _with(self, operation, other):
        others = other if _has_rows(other) else (other,) * len(self)
        return Matrix(row._with(operation, entries) for row, entries in zip(self, others, strict=True))


def _has_rows(value: object) -> bool:
    return isinstance(value, tuple | list) and len(value) > 0 and isinstance(value[0], tuple | list)


def identity(size: int) -> Matrix:
    """Ones on the diagonal."""
    return Matrix(np.eye(size).tolist())


def zeros(rows: int, columns: int) -> Matrix:
    """Nothing but zeros."""
    return Matrix(((0.0,) * columns,) * rows)


for _kind in (Vector, Matrix):
    jax.tree_util.register_pytree_with_keys(
        _kind,
        lambda small: ([(jax.tree_util.SequenceKey(i), entry) for i, entry in enumerate(small)], None),
        lambda _, entries, kind=_kind: tuple.__new__(kind, entries),
        lambda small: (tuple(small), None),
    )
