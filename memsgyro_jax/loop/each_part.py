"""Parts from outside the package beside its own in a lot: each of them is mapped over the dies by itself, so that the
package's parts compute dies side by side as ever. Mapped as a whole, a run took twice the time.
"""

import functools
from collections.abc import Callable, Mapping
from dataclasses import fields
from typing import Any, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from memsgyro_jax.base.own_code import is_outside
from memsgyro_jax.device.carried import Effects

from .controllers.base import AbstractController
from .die_by_die import from_outside
from .filters import AbstractFilter
from .loop import ClosedLoop
from .observers.base import AbstractCovarianceObserver, AbstractObserver, Estimate
from .readout import AbstractReadout
from .scenario import AbstractProfile


Lot = TypeVar("Lot", bound=tuple[Any, ...])
Ranks = list[int]


def each_mapped(dies: Lot, design: Lot) -> Lot | None:
    """`dies`, a loop and a scenario say, with every part from outside mapped over them by itself; `design` is the like
    of a single die. None where the loop asks a part for more than the methods of its port, so that only the whole can
    be mapped.
    """
    if not from_outside(*design):
        return dies
    outer = [part for part in jax.tree.leaves(design, is_leaf=_stops) if _is_part(part)]
    if not all(_can_be(part) for part in outer) or any(_asks_for_more(part, outer) for part in design):
        return None
    return jax.tree.map(lambda part, one: _mapped(part, one) if _is_part(part) else part, dies, design, is_leaf=_stops)


def _stops(tree: Any) -> bool:
    return isinstance(tree, Effects) or _is_part(tree)


def _is_part(tree: Any) -> bool:
    return isinstance(tree, eqx.Module) and is_outside(type(tree))


def _asks_for_more(design: Any, outer: list[eqx.Module]) -> bool:
    """Whether a loop goes by blocks, which read more of a part than its port, or hands effects to a read-out."""
    read = any(isinstance(part, AbstractReadout) for part in outer)
    return isinstance(design, ClosedLoop) and (design.blocks is not None or (read and bool(design.device.effects)))


def _can_be(part: eqx.Module) -> bool:
    """Whether a part is one of a port, and answers by nothing of its own but that port's methods."""
    kinds = type(part).__mro__
    own = {name for kind in kinds if is_outside(kind) and kind is not object for name in vars(kind) if name[0] != "_"}
    answers = {name: of for kind in kinds if not is_outside(kind) for name, of in vars(kind).items() if _computes(of)}
    if not isinstance(part, tuple(_PORTS)) or own & set(answers) - set(_methods(type(part))) - _OF_NO_DIE:
        return False
    kept = jax.tree.leaves(_at_first(part))
    return all(jnp.issubdtype(leaf.dtype, np.number) or leaf.dtype == bool for leaf in kept)


def _computes(member: Any) -> bool:
    return callable(member) or isinstance(member, property)


def _at_first(part: Any) -> Any:
    """Shapes of the state of a part at time zero; none of a part that has no state."""
    return jax.eval_shape(part.init) if hasattr(part, "init") else ()


class _Like(eqx.Module):
    """What a part and its state are for a single die: structure, and axes of each leaf."""

    part: Any = eqx.field(static=True)
    ranks: tuple[int, ...] = eqx.field(static=True)
    state: tuple[int, ...] = eqx.field(static=True)


def _numbers(given: Any, like: _Like) -> Ranks:
    return [0] * len(jax.tree.leaves(given))


def _pair(given: Any, like: _Like) -> Ranks:
    """Of numbers in a tuple, or in an array whose first axis counts them."""
    return _numbers(given, like) if isinstance(given, tuple | list) else [1] * len(jax.tree.leaves(given))


def _state(given: Any, like: _Like) -> Ranks:
    return list(like.state)


def _estimate(given: Estimate, like: _Like) -> Ranks:
    told = given.innovation
    pairs = (given.motion, given.theta, given.offset, *(() if told is None else (told.error, told.variance)))
    ranks = [_pair(part, like) for part in pairs]
    ranks.insert(3, _numbers(given.rate_variance, like))
    return [rank for part in (*ranks, _numbers(given.readings, like)) for rank in part]


Method = tuple[Callable[[Any, _Like], Ranks], ...]
_PORTS: Mapping[type, Mapping[str, Method]] = {
    AbstractController: {
        "init": (),
        "command": (_state, _estimate, _numbers),
        "measured": (_state, _pair, _numbers),
        "output": (_state, _estimate),
    },
    AbstractCovarianceObserver: {"covariance": (_state,), "error": (_state, _pair, _pair, _pair)},
    AbstractObserver: {"init": (), "update": (_state, _pair, _pair, _numbers), "estimate": (_state,)},
    AbstractReadout: {
        "measure": (_pair, _pair, _pair, _numbers),
        "clean": (_pair, _pair),
        "noise_std": (_numbers,),
    },
    AbstractFilter: {"init": (_numbers,), "step": (_state, _numbers, _numbers)},
    AbstractProfile: {"value": (_numbers,)},
}
_OF_NO_DIE = {"states", "known", "bounds", "edges", "model", "signals", "learns", "usually_tuned", "hindrance"}


def _methods(kind: type) -> dict[str, Method]:
    return {name: how for port, each in _PORTS.items() if issubclass(kind, port) for name, how in each.items()}


def _mapped(part: eqx.Module, one: eqx.Module) -> eqx.Module:
    """`part`, whose methods are those of single dies, mapped."""
    leaves, structure = jax.tree.flatten(one)
    state = jax.tree.leaves(_at_first(one))
    made: eqx.Module = object.__new__(_class_of(type(part)))
    for field in fields(part):
        object.__setattr__(made, field.name, getattr(part, field.name))
    like = _Like(structure, tuple(map(np.ndim, leaves)), tuple(leaf.ndim for leaf in state))
    object.__setattr__(made, "of_one_die", like)
    return made


@functools.cache
def _class_of(kind: type) -> type:
    """The class of `kind`s that are mapped."""
    body: dict[str, Any] = {name: _over_dies(name, how) for name, how in _methods(kind).items()}
    body |= {"__module__": kind.__module__, "__annotations__": {"of_one_die": Any}}
    return type(kind)(kind.__name__, (kind,), {**body, "of_one_die": eqx.field(static=True, default=None)})


def _over_dies(name: str, how: Method) -> Callable[..., Any]:
    """Method `name`, mapped over the dies that trail in what it is given."""

    def method(self: Any, *given: Any, **named: Any) -> Any:
        like: _Like = self.of_one_die
        ranks = [*like.ranks, *(rank for tell, each in zip(how, given, strict=False) for rank in tell(each, like))]
        leaves, structure = jax.tree.flatten((jax.tree.leaves(self), given, named))
        ranks += [0] * (len(leaves) - len(ranks))
        varies = [np.ndim(leaf) > rank for leaf, rank in zip(leaves, ranks, strict=True)]

        def of_one(varied: list[Any]) -> Any:
            rest = iter(varied)
            filled = [next(rest) if moves else leaf for leaf, moves in zip(leaves, varies, strict=True)]
            part, positional, keywords = jax.tree.unflatten(structure, filled)
            return getattr(jax.tree.unflatten(like.part, part), name)(*positional, **keywords)

        varied = [leaf for leaf, moves in zip(leaves, varies, strict=True) if moves]
        return jax.vmap(of_one, in_axes=-1, out_axes=-1)(varied) if varied else of_one([])

    method.__name__ = name
    return method
