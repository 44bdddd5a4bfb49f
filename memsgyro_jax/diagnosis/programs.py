"""Which effects a compiled program carries: an absent one beside those asked for costs less than another program."""

from collections.abc import Set

from memsgyro_jax.effects.base import Effect, LockInEffect, ReadoutEffect, SweepEffect


SPARE = 4  # absent effects that a program may have beside those asked for, before another is made


class Programs:
    """The sets of effects, by name, that there are programs for, and one that is going to be asked for in parts."""

    def __init__(self) -> None:
        self.made: list[frozenset[str]] = []
        self.announced: frozenset[str] = frozenset()

    def chosen(self, acting: frozenset[str], idle: Set[str]) -> frozenset[str]:
        """The fewest effects, those `acting` among them, that there is a program for, or is going to be; the others
        must be `idle`, and few. The base model, which is linear and quick, has its own.
        """
        if acting in self.made or not acting:
            return acting
        for known in (self.made, [self.announced]):
            wide = [one for one in known if acting <= one and one - acting <= idle and len(one - acting) <= SPARE]
            if wide:
                break
        best = min(wide, key=len, default=acting)
        self.made += [] if best in self.made else [best]
        return best


def of_lock_in(effect: Effect) -> bool:
    """Whether an effect is what the lock-in does, behind all that the device does."""
    return isinstance(effect, LockInEffect)


def is_idle(effect: Effect) -> bool:
    """Whether an effect costs a program little where its strength is zero: it asks for no finer or other prediction."""
    rings = isinstance(effect, LockInEffect) and effect.rings
    sharp = isinstance(effect, ReadoutEffect) and effect.sharp
    return not (rings or sharp or getattr(effect, "own_size", 0) or isinstance(effect, SweepEffect))
