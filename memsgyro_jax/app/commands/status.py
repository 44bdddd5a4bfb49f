"""`memsgyro status`: how far a sweep is that others compute."""

from pathlib import Path


def status_command(out: Path = Path("sweep-out"), /) -> None:
    """How many dies of a sweep's store are done, lost and diverged, and how many processes are at work on it.

    Args:
        out: the folder that was given to `memsgyro sweep --out`.
    """
    from memsgyro_jax.montecarlo.standing import standing_of

    print(standing_of(out))
