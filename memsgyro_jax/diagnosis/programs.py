"""Which effects a compiled program carries: an absent one beside those asked for costs less than another program."""

import threading
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from memsgyro_jax.effects import TERMS
from memsgyro_jax.effects.base import Effect, LockInEffect, ReadoutEffect, SweepEffect


SPARE = 8  # absent effects that a program may have beside those asked for, before another is made: so many make it
# a seventh slower, and another takes as long to compile as some twenty-five calls
PROGRAM = 50  # predictions that take as long as what a further set of effects asks for


@dataclass
class Effort:
    """What a search has taken, in predictions of single experiments.

    Args:
        most: after so many it begins nothing new where it is far from noise.
        spent: since it began.
        ended: whether something was not begun.
    """

    most: float = np.inf
    spent: int = 0
    ended: bool = False
    _one_at_a_time: threading.Lock = field(default_factory=threading.Lock, repr=False, compare=False)

    def take(self, count: int) -> None:
        """So many more, in any thread."""
        with self._one_at_a_time:
            self.spent += count


class Programs:
    """The sets of effects, by name, that there are programs for, with their order in it; those that are going to be
    asked for in parts, the likeliest first; which effects are known to be linear, or not; in which order models have
    them; all effects of programs, absent, as another model of the case may lack one; and the effort of all.
    """

    def __init__(self) -> None:
        self.made: dict[frozenset[str], tuple[str, ...]] = {}
        self.announced: tuple[str, ...] = ()
        self.spare = SPARE
        self.linear: dict[str, bool] = {}
        self.order: dict[str, int] = {}
        self.absent: dict[str, Effect] = {}
        self.effort = Effort()
        self.one_at_a_time = threading.Lock()  # for threads that ask which program is theirs

    def know(self, names: Iterable[str]) -> None:
        """The effects of a model, in its order; the first is that of the whole catalogue."""
        for name in names:
            self.order.setdefault(name, len(self.order))

    def chosen(self, acting: frozenset[str], idle: Callable[[str], bool]) -> frozenset[str]:
        """The fewest effects, those `acting` among them, that there is a program for, or is going to be; the others
        must be `idle`, and few. The base model, which is linear and quick, has its own.
        """
        if acting in self.made or not acting:
            return acting
        together = self.announced if acting <= set(self.announced) else ()
        wide = [one for one in self.made if acting <= one and len(one - acting) <= (self.spare if together else SPARE)]
        wide = [one for one in wide if all(map(idle, one - acting))]
        if wide:
            return min(wide, key=len)
        others = [name for name in together if name not in acting and idle(name)]
        best = acting | frozenset(others[: self.spare])
        self.made[best] = ()
        self.effort.take(PROGRAM)
        return best

    def announce(self, effects: Sequence[tuple[str, Effect]], spare: int = SPARE) -> None:
        """Effects that are going to be asked for one after the other, the likeliest first, by this or another model; so
        many that are absent a program may have.
        """
        self.announced, self.spare = tuple(dict.fromkeys(name for name, _ in effects)), spare
        self._remember(effects)

    def _remember(self, effects: Sequence[tuple[str, Effect]]) -> None:
        for name, effect in effects:
            if name not in self.absent:
                self.absent[name] = eqx.tree_at(lambda e: e.strength, effect, jnp.zeros_like(effect.strength))

    def in_order(self, chosen: frozenset[str], effects: Sequence[tuple[str, Effect]]) -> list[str]:
        """The effects of a program in one order, so that it is the same program whichever model asks for it. Those of
        the model keep theirs, what the lock-in does last; what the model lacks is absent, and may stand anywhere: terms
        of the instrument where another model has them.
        """
        mine = [name for name, effect in sorted(effects, key=lambda pair: of_lock_in(pair[1])) if name in chosen]
        self._remember([pair for pair in effects if pair[0] in chosen])
        known = self.made.get(chosen, ())
        if not chosen or [name for name in known if name in mine] == mine:
            return list(known)
        lacking = sorted(chosen - set(mine), key=lambda name: (of_lock_in(self.absent[name]), self.order[name]))
        order = sorted((*mine, *lacking), key=lambda name: _of_signal(self.absent[name]))
        if [name for name in order if name in mine] != mine:
            order = sorted((*mine, *lacking), key=lambda name: of_lock_in(self.absent[name]))
        self.made[chosen] = tuple(order)
        return order


def of_lock_in(effect: Effect) -> bool:
    """Whether an effect is what the lock-in does, behind all that the device does."""
    return isinstance(effect, LockInEffect)


def _of_signal(effect: Effect) -> tuple[bool, int]:
    """Where an effect stands among others: terms of the instrument before effects of the device, in their own order."""
    return of_lock_in(effect), TERMS.index(type(effect)) if isinstance(effect, TERMS) else len(TERMS)


def is_idle(effect: Effect) -> bool:
    """Whether an effect costs a program little where its strength is zero: it asks for no finer or other prediction."""
    rings = isinstance(effect, LockInEffect) and effect.rings
    sharp = isinstance(effect, ReadoutEffect) and effect.sharp
    return not (rings or sharp or getattr(effect, "own_size", 0) or isinstance(effect, SweepEffect))
