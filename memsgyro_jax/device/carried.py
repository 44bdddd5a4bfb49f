"""What a device carries beyond its equations of motion: effects, and the surroundings in which its numbers hold."""

import abc
from collections.abc import Callable, Iterable
from typing import TYPE_CHECKING, Any, ClassVar, Self

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from memsgyro_jax.base.concrete import is_concrete
from memsgyro_jax.base.display import Displayed
from memsgyro_jax.base.errors import InputError
from memsgyro_jax.base.fields import AbstractVar


class AbstractEffect(Displayed):
    """What a device must know of an effect that it carries: its name, and how many axes it needs."""

    name: ClassVar[str] = ""

    if TYPE_CHECKING:  # a member's field may stand in the place of a property, not of a class variable

        @property
        def strength(self) -> Array: ...

    else:
        strength: AbstractVar[Array]

    @property
    @abc.abstractmethod
    def label(self) -> str:
        """Name and variant, e.g. `cubic_stiffness x`."""

    @property
    @abc.abstractmethod
    def axes_needed(self) -> int:
        """How many axes a device must have for this effect."""


def check_effect(effect: object, axes: int) -> None:
    """Refuse what is no effect, and an effect on an axis that the device does not have."""
    if not isinstance(effect, AbstractEffect):
        raise InputError(f"An effect must be an instance of `effects.Effect`, but {effect!r} was given.")
    if effect.axes_needed > axes:
        raise InputError(f"Effect `{effect.label}` needs {effect.axes_needed} axes, but the device has {axes}.")


class Effects(tuple):
    """The effects of a device: a tuple, of which a member is also reached by its label, as in
    `gyro.effects.cubic_stiffness_x`.

    `ranks` remembers how many axes each number of the effects had when they joined, so that a table is not mistaken for
    one number per die.
    """

    ranks: tuple[int, ...]

    @classmethod
    def of(cls, effects: Iterable[AbstractEffect]) -> tuple[AbstractEffect, ...]:
        """From any effects; none at all are a plain empty tuple.

        **Raises:** `InputError` for what is no effect.
        """
        if isinstance(effects, cls):
            return effects
        if isinstance(effects, str | AbstractEffect) or not isinstance(effects, Iterable):
            raise InputError(f"Effects must be a tuple of them, but a {type(effects).__name__} was given.")
        members = tuple(effects)
        for member in members:
            check_effect(member, 2)
        return members and cls._with(members, tuple(jnp.ndim(leaf) for leaf in jax.tree.leaves(members)))

    @classmethod
    def _with(cls, members: Iterable[Any], ranks: tuple[int, ...]) -> "Effects":
        made = cls(members)
        made.ranks = ranks
        return made

    def __getattr__(self, name: str) -> Any:
        found = [effect for effect in self if getattr(effect, "label", "").replace(" ", "_") == name]
        if len(found) != 1:
            raise AttributeError(f"{len(found)} effects are called `{name}`")
        return found[0]


jax.tree_util.register_pytree_with_keys(
    Effects,
    lambda effects: ([(jax.tree_util.SequenceKey(i), e) for i, e in enumerate(effects)], effects.ranks),
    lambda ranks, members: Effects._with(members, ranks),
    lambda effects: (tuple(effects), effects.ranks),
)


def each_die(function: Callable[..., Any], *arguments: Any) -> Any:
    """`function` of arguments written for one die, mapped over the dies that trail in them and in what it returns.

    Whatever is not in `Effects` is a scalar for one die; the numbers of effects have the axes that they joined with.
    """
    leaves, structure = jax.tree.flatten(arguments)
    lanes = [getattr(leaf, "ndim", 0) - rank for leaf, rank in zip(leaves, _ranks(arguments), strict=True)]
    varies = [depth > 0 for depth in lanes]

    def one(*varied: Any) -> Any:
        rest = iter(varied)
        chosen = [next(rest) if own else leaf for own, leaf in zip(varies, leaves, strict=True)]
        return function(*structure.unflatten(chosen))

    mapped = one
    for _ in range(max(lanes, default=0)):
        mapped = jax.vmap(mapped, in_axes=-1, out_axes=-1)
    return mapped(*[leaf for own, leaf in zip(varies, leaves, strict=True) if own])


def _ranks(tree: Any) -> list[int]:
    parts = jax.tree.leaves(tree, is_leaf=lambda part: isinstance(part, Effects))
    return [rank for part in parts for rank in (part.ranks if isinstance(part, Effects) else (0,))]


class CarriesEffects(Displayed):
    """A device that effects can be given to.

    `reference_temperature` [K] and `reference_bias` [V] are those at which its numbers hold: what effects call no
    warming and no change of the bias.
    """

    effects: tuple[Any, ...] = eqx.field(kw_only=True, default=(), converter=Effects.of)
    reference_temperature: float = eqx.field(kw_only=True, static=True, repr=False, default=298.15, converter=float)
    reference_bias: float = eqx.field(kw_only=True, static=True, repr=False, default=0.0, converter=float)
    axes: ClassVar[int] = 2

    def __check_init__(self):
        for effect in self.effects:
            check_effect(effect, self.axes)

    def with_effect(self, *effects: AbstractEffect) -> Self:
        """The same device with further effects.

        **Raises:** `InputError` for what is no effect, and for one that needs more axes than the device has.
        """
        return self.with_only((*self.effects, *effects))

    def with_only(self, effects: Iterable[AbstractEffect]) -> Self:
        """The same device with these effects and no others."""
        made = eqx.tree_at(
            lambda d: d.effects, self, Effects.of(tuple(effects)), is_leaf=lambda part: isinstance(part, tuple)
        )
        CarriesEffects.__check_init__(made)
        return made

    @property
    def present(self) -> Self:
        """The same device without the effects of strength zero, which are absent; strengths not known now stay."""
        kept = [e for e in self.effects if not is_concrete(e.strength) or np.any(np.asarray(e.strength))]
        return self if len(kept) == len(self.effects) else self.with_only(kept)
