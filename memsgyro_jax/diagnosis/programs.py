"""Which effects a compiled program carries: an absent one beside those asked for costs less than another program."""

from collections.abc import Callable

from memsgyro_jax.effects.base import Effect, LockInEffect, ReadoutEffect, SweepEffect


SPARE = 4  # absent effects that a program may have beside those asked for, before another is made


class Programs:
    """The sets of effects, by name, that there are programs for; those that are going to be asked for in parts, the
    likeliest first; and which effects are known to be linear, or not.
    """

    def __init__(self) -> None:
        self.made: list[frozenset[str]] = []
        self.announced: tuple[str, ...] = ()
        self.linear: dict[str, bool] = {}

    def chosen(self, acting: frozenset[str], idle: Callable[[str], bool]) -> frozenset[str]:
        """The fewest effects, those `acting` among them, that there is a program for, or is going to be; the others
        must be `idle`, and few. The base model, which is linear and quick, has its own.
        """
        if acting in self.made or not acting:
            return acting
        wide = [one for one in self.made if acting <= one and len(one - acting) <= SPARE]
        wide = [one for one in wide if all(map(idle, one - acting))]
        if wide:
            return min(wide, key=len)
        together = self.announced if acting <= set(self.announced) else ()
        others = [name for name in together if name not in acting and idle(name)]
        best = acting | frozenset(others[:SPARE])
        self.made.append(best)
        return best


def of_lock_in(effect: Effect) -> bool:
    """Whether an effect is what the lock-in does, behind all that the device does."""
    return isinstance(effect, LockInEffect)


def is_idle(effect: Effect) -> bool:
    """Whether an effect costs a program little where its strength is zero: it asks for no finer or other prediction."""
    rings = isinstance(effect, LockInEffect) and effect.rings
    sharp = isinstance(effect, ReadoutEffect) and effect.sharp
    return not (rings or sharp or getattr(effect, "own_size", 0) or isinstance(effect, SweepEffect))
