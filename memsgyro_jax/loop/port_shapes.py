"""What parts from outside the package return, looked at before a run: another shape ended in a text about a scan."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, PyTree

from memsgyro_jax.base.errors import InputError
from memsgyro_jax.base.own_code import amiss_in_arguments, is_outside, traced, untraced, where_in
from memsgyro_jax.base.text import excerpt
from memsgyro_jax.device.gyro import AbstractGyro
from memsgyro_jax.effects.base import Effect
from memsgyro_jax.effects.evaluation import Acting
from memsgyro_jax.effects.trial import misshapen

from . import engine, noise
from .controllers.base import AbstractController
from .die_by_die import from_outside, own_parts
from .loop import ClosedLoop, LoopState
from .observers.base import AbstractObserver, Clock, Estimate
from .own_parts import commanded, estimated
from .readout import AbstractReadout
from .scenario import AbstractProfile, Scenario


_NUMBER = jax.ShapeDtypeStruct((), float)
_PAIR = (_NUMBER, _NUMBER)


def check_ports(loop: ClosedLoop, scenario: Scenario, period: float) -> None:
    """Trace what parts from outside return for a sample of `period` [s]; the package's own cost nothing.

    **Raises:** `InputError` that names class and method, for a state that is not like that of `init`, for what is not
    the numbers that the port asks for, for other arguments than the port's, for what JAX cannot follow, as an `if` on a
    number, and for what reaches beyond the end of an array.
    """
    _check_effects(loop.device)
    if not from_outside(loop.readout, loop.observer, loop.controller, loop.filter, loop.discretisation, scenario):
        return
    shows = loop.device.effects and Acting.of(loop.device.effects).readouts
    by_name = ("effects",) * bool(shows) + ("late",) * (loop.readout.flicker is not None)
    _check_arguments(loop.readout, named=by_name)
    _check_arguments(loop.observer, loop.controller, loop.filter, loop.discretisation, scenario)
    for profile in jax.tree.leaves(scenario, is_leaf=lambda part: isinstance(part, AbstractProfile)):
        if isinstance(profile, AbstractProfile) and from_outside(profile):
            _numbers(_given(profile, "value", profile.value, _NUMBER), None, profile, "value", "a number")
    if from_outside(loop.readout):
        _check_readout(loop.readout, period)
    if from_outside(loop.observer):
        _check_observer(loop.observer, period)
    if from_outside(loop.controller):
        _check_controller(loop.controller, loop.observer, period)


def check_loss(loss: Any, loop: ClosedLoop, scenario: Scenario, period: float) -> None:
    """The same for a loss from outside, at a sample of `loop`.

    **Raises:** `InputError` as `check_ports`.
    """
    if not from_outside(loss):
        return
    _check_arguments(loss)
    warm, flickers = loop.device.temperature is not None, engine.flickers_of(loop)

    def sampled(memory: Any, state: LoopState) -> Any:
        words = noise.die_words(jax.random.key(0), jnp.zeros((), int))
        row = engine.entering(scenario, words, period, 1, jnp.zeros((), int), 1, warm, flickers)
        return engine.one_sample(loop, period, loss, (state, memory), jax.tree.map(lambda part: part[0], row))[1]

    memory = _given(loss, "init", loss.init)
    _alike(_given(loss, "sample", sampled, memory, jax.eval_shape(loop.init)), memory, loss, "sample")
    _numbers(_given(loss, "value", loss.value, memory), None, loss, "value", "a number, the loss of a die")


def _check_arguments(*parts: Any, named: tuple[str, ...] = ()) -> None:
    for part in own_parts(*parts):
        for words in amiss_in_arguments(part, named):
            raise InputError(f"{words[0].upper()}{words[1:]}.")


def _check_effects(device: AbstractGyro) -> None:
    """Those of a user's own, of one die, which a file of them has been asked the same of."""
    leaves, structure = jax.tree.flatten(device.effects)
    ranks = getattr(device.effects, "ranks", ())
    one = [leaf[(..., *(0,) * (jnp.ndim(leaf) - rank))] for leaf, rank in zip(leaves, ranks, strict=True)]
    for effect in jax.tree.unflatten(structure, one):
        if is_outside(type(effect)) and isinstance(effect, Effect):
            found = _followed(effect, "force", lambda each=effect: misshapen(each, device.axes))
            if found:
                raise InputError(f"Effect `{effect.label}`: {found}.")


def _check_readout(readout: AbstractReadout, period: float) -> None:
    std = _given(readout, "noise_std", lambda: readout.noise_std(period))
    _numbers(std, 2, readout, "noise_std", "two numbers, V of x and y")
    volts = _given(readout, "measure", lambda at, n, d: readout.measure(at, n, d, period), (_NUMBER,) * 4, _PAIR, _PAIR)
    _numbers(volts, 2, readout, "measure", "two numbers, V of x and y")


def _check_observer(observer: AbstractObserver, period: float) -> None:
    state = _given(observer, "init", observer.init)
    later = _given(observer, "update", lambda at, v, f: observer.update(at, v, f, _clock(period)), state, _PAIR, _PAIR)
    _alike(later, state, observer, "update")
    estimate = _given(observer, "estimate", lambda at: estimated(observer, at), state)
    count = len(observer.model.names)
    for name, many in (("motion", 4), ("theta", count), ("offset", 2)):
        wanted = f"an `Estimate` whose `{name}` is {many} numbers"
        _numbers(getattr(estimate, name), many, observer, "estimate", wanted)


def _check_controller(controller: AbstractController, observer: AbstractObserver, period: float) -> None:
    state = _given(controller, "init", controller.init)
    seen = jax.eval_shape(lambda: observer.estimate(observer.init()))

    def command(at: Any, estimate: Estimate) -> Any:
        return commanded(controller, at, estimate, _clock(period))

    force, later = _given(controller, "command", command, state, seen)
    _numbers(force, 2, controller, "command", "two forces in N and the state: each force a number")
    name = "command"
    if type(controller).measured is not AbstractController.measured:
        later = _given(controller, "measured", lambda at, v: controller.measured(at, v, _clock(period)), later, _PAIR)
        name = "measured"
    _alike(later, state, controller, name)
    if type(controller).output is not AbstractController.output:
        _given(controller, "output", controller.output, state, seen)


def _clock(period: float) -> Clock:
    return Clock(jnp.zeros(()), jnp.zeros((), int), period)


def _given(part: Any, method: str, function: Callable[..., Any], *given: PyTree) -> Any:
    """Shapes of what a method returns."""

    def number(leaf: Any) -> Array:
        try:
            return jnp.asarray(leaf)
        except (TypeError, ValueError) as error:
            raise InputError(
                f"Method `{method}` of {type(part).__name__} must return numbers, but returns {excerpt(leaf)} of type "
                f"{type(leaf).__name__}."
            ) from error

    whole = lambda *at: jax.tree.map(number, function(*at))  # noqa: E731
    shapes, far = _followed(part, method, lambda: traced(whole, *given))
    if far:
        raise InputError(
            f"Method `{method}` of {type(part).__name__} must stay within its arrays, but {far}: JAX would take the "
            "last entry in its place."
        )
    return shapes


def _followed(part: Any, method: str, called: Callable[[], Any]) -> Any:
    """What `called` gives; raises `InputError` where JAX cannot follow the method."""
    try:
        return called()
    except Exception as error:
        if not (words := untraced(error)):
            raise
        kind = next((type(own) for own in own_parts(part)), type(part))
        name, line = where_in(error, kind)
        where = f" (line {line} of its file)" if line else ""
        raise InputError(
            f"Method `{name or method}` of {kind.__name__}{where} must be one that JAX can follow, but {words}."
        ) from error


def _numbers(found: Any, many: int | None, part: Any, method: str, wanted: str) -> None:
    """Refuse what is not so many numbers, a tuple or an array of them; with None, what is not a single one."""
    shape = getattr(found, "shape", None)
    if shape == (() if many is None else (many,)):
        return
    if isinstance(found, tuple | list) and len(found) == many and all(getattr(n, "shape", None) == () for n in found):
        return
    raise InputError(f"Method `{method}` of {type(part).__name__} must return {wanted}, but returns {_text(found)}.")


def _alike(later: Any, state: Any, part: Any, method: str) -> None:
    """Refuse a state that is another than `init` gives."""
    if jax.tree.structure(later) == jax.tree.structure(state):
        pairs = zip(jax.tree.leaves(later), jax.tree.leaves(state), strict=True)
        if all((new.shape, new.dtype) == (old.shape, old.dtype) for new, old in pairs):
            return
    whole = any(jnp.issubdtype(leaf.dtype, jnp.integer) for leaf in jax.tree.leaves(state))
    hint = "; what counts no samples begins as 0.0, not as 0" if whole else ""
    raise InputError(
        f"Method `{method}` of {type(part).__name__} must return a state of the shapes and kinds that `init` gives, "
        f"{_text(state)}, but returns {_text(later)}{hint}."
    )


def _text(found: Any) -> str:
    if isinstance(found, tuple | list):
        return f"({', '.join(map(_text, found))})"
    shape = getattr(found, "shape", None)
    if shape is None:
        return type(found).__name__
    return f"{found.dtype}{f' of shape {shape}' if shape else ''}"
