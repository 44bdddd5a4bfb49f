"""What observers and controllers of a user's own hand to the loop: refused where it is of another shape."""

from typing import Any

import numpy as np

from memsgyro_jax.base.concrete import is_concrete
from memsgyro_jax.base.errors import InputError
from memsgyro_jax.base.own_code import is_outside
from memsgyro_jax.device.gyro import Pair

from .controllers.base import AbstractController
from .observers.base import AbstractObserver, Estimate


def inner(controller: Any) -> Any:
    """The law within what only limits or times it."""
    while isinstance(within := getattr(controller, "inner", None), AbstractController):
        controller = within
    return controller


def check_within_travel(controller: AbstractController, travel: Any) -> None:
    """Raises `InputError` for a drive that would hold a swing beyond the `travel` [m] at which a die is lost."""
    amplitude = getattr(getattr(inner(controller), "drive", None), "amplitude", None)
    if amplitude is None or not is_concrete(amplitude, travel):
        return
    most, least = float(np.max(np.asarray(amplitude))), float(np.min(np.asarray(travel)))
    if most >= least:
        raise InputError(
            f"Argument `amplitude` of the controller must be below the loop's travel of {1e6 * least:.4g} µm, beyond "
            f"which a die is lost, but is {1e6 * most:.4g} µm; lower it, or give the loop a larger `travel`."
        )


def estimated(observer: AbstractObserver, state: Any) -> Estimate:
    """What `observer` says at `state`; raises `InputError` where that is no `Estimate`."""
    given = observer.estimate(state)
    if not isinstance(given, Estimate):
        raise InputError(
            f"Method `estimate` of {type(observer).__name__} must return `mg.Estimate(motion, theta, offset, model)`, "
            f"but returns {_told(given)}."
        )
    return given


def commanded(controller: AbstractController, state: Any, estimate: Estimate, clock: Any) -> tuple[Pair, Any]:
    """The forces of `controller` and its new state; raises `InputError` where they are not so."""
    given = controller.command(state, estimate, clock)
    must = f"Method `command` of {type(controller).__name__} must return `(force_x, force_y), state`, forces in N, but"
    if not isinstance(given, tuple | list) or len(given) != 2:
        raise InputError(f"{must} returns {_told(given)}.")
    force, state = given
    if (count := _length(force)) != 2:
        raise InputError(f"{must} its force is {_told(force) if count is None else f'of {count} numbers'}.")
    return (force[0], force[1]), state


def overridden(part: object, *methods: str) -> str | None:
    """Which of `methods`, that a class of the package has, the class of `part` gives otherwise, in words; None for
    none. A method that the package leaves open is promised, not overridden.
    """
    kind = type(part)
    base = next(one for one in kind.__mro__ if not is_outside(one) or one is object)
    known = [name for name in methods if hasattr(base, name) and name not in getattr(base, "__abstractmethods__", ())]
    own = [name for name in known if is_outside(next(one for one in kind.__mro__ if name in vars(one)))]
    return f"{kind.__name__} has its own `{'`, `'.join(own)}`, which blocks do not follow" if own else None


def _length(given: Any) -> int | None:
    try:
        return len(given)
    except TypeError:  # a single number, traced or not
        return None


def _told(given: Any) -> str:
    many = f" of {len(given)} entries" if isinstance(given, tuple | list) else ""
    return "None" if given is None else f"what is of type {type(given).__name__}{many}"
