"""Which motion tells the rate best, under limits on displacement and force and under stated errors of the model."""

import math
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from memsgyro_jax.base.arguments import quantity, refuse_traced, whole
from memsgyro_jax.base.errors import InputError
from memsgyro_jax.base.runtime import require_float64
from memsgyro_jax.device.gyro import AbstractGyro, check_positive, mode_frequencies
from memsgyro_jax.loop.controllers import OpenLoop
from memsgyro_jax.loop.loop import ClosedLoop
from memsgyro_jax.loop.observers import ExtendedKalmanFilter
from memsgyro_jax.loop.operation import Operation
from memsgyro_jax.loop.readout import AbstractReadout, ChargeAmplifier
from memsgyro_jax.loop.scenario import as_scenario
from memsgyro_jax.loop.trace import count_steps
from memsgyro_jax.montecarlo.spread import Spread

from .aim import aim, modes, stay
from .errors import ModelErrors
from .result import MotionDesign, Setting, finished
from .search import Problem, search


_SLOTS = 4  # designs of up to so many tones share one compiled program
_USELESS = 1e4  # rad/s
_ALIKE = 0.01  # starts that end within this share of the best count as having found it


def design_motion(
    gyro: AbstractGyro,
    readout: AbstractReadout | None = None,
    *,
    tones: int = 4,
    own_axis: bool = False,
    displacement: float | str = 1e-6,
    force: float | str = math.inf,
    errors: ModelErrors | None = None,
    known: tuple[str, ...] = (),
    spread: Spread | None = None,
    dies: int = 8,
    aiming: bool = True,
    band: tuple[float, float] | None = None,
    rate: float | str = 1.0,
    sample_rate: float | str | None = None,
    duration: float | str | None = None,
    starts: int = 16,
    steps: int = 200,
    seed: int = 0,
) -> MotionDesign:
    """Frequencies, amplitudes and phases of `tones` that let the rate be known best after `duration` [s].

    What is made small is the information bound of the rate, with motion, offsets and coefficients unknown (but for the
    `known` ones) and `errors` of the model known a priori to their standard deviations. The default is `ModelErrors()`:
    a design for a right model uses what the model omits; it is made too, as `nominal`, to show the difference.
    `own_axis=True` lets every tone move one axis only, x and y in turn. `displacement` [m] and `force` [N] bound the
    sum of amplitudes of each axis, `band` [Hz] the frequencies (default: half the lower to one and a half the upper
    mode). With a `spread`, the mean logarithm over `dies` is made small, each of which moves in the design aimed at it
    (`MotionDesign.aimed_at`), or, `aiming=False`, like the design device. The search descends from the `starts` best of
    many random designs, `steps` steps each.

    Left out, `sample_rate` and `duration` follow the device (`Operation`).
    The bound is local: it takes the observer to be near the truth. A mass, say, that a tone of a picometre would tell
    in principle is then as good as unknown to a filter; count with errors, or name what is `known`.

    Raises `InputError` for what cannot be: no tone, limits that are not positive, an empty band or one beyond half the
    sample rate, an unknown name, a read-out without noise, fewer tones than the unknowns need.
    """
    require_float64("`design_motion`")
    refuse_traced("`design_motion` searches and", "plain numbers, or take `information_bound`", gyro, readout)
    tones, dies, starts, seed = (
        whole(name, number, least)
        for name, number, least in (("tones", tones, 1), ("dies", dies, 1), ("starts", starts, 1), ("seed", seed, 0))
    )
    rate, displacement = quantity("rate", rate, "rad/s"), quantity("displacement", displacement, "m")
    force = quantity("force", force, "N")
    readout = ChargeAmplifier.chi2010() if readout is None else readout
    if sample_rate is None or duration is None:
        usual = Operation.of(gyro, readout)
        sample_rate = usual.sample_rate if sample_rate is None else sample_rate
        duration = usual.duration if duration is None else duration
    sample_rate, duration = quantity("sample_rate", sample_rate, "Hz"), quantity("duration", duration, "s")
    lower, upper = mode_frequencies(gyro)
    band = (0.5 * float(lower), 1.5 * float(upper)) if band is None else band
    setting = Setting(gyro, readout, tuple(known), rate, sample_rate, duration, displacement, force)
    _check(setting, band)
    errors = ModelErrors() if errors is None else errors
    die = setting.plant()
    gyros = [gyro] if spread is None else _drawn(setting, spread, dies, seed)
    lot = [(setting.plant(each), aim(gyro, each) if aiming else stay(gyro)) for each in gyros]
    stacked, aims = jax.tree.map(lambda *leaves: np.stack(leaves), *lot)

    def found(errors: ModelErrors) -> MotionDesign:
        problem = Problem(
            stacked, aims, die, setting.free, jnp.asarray(errors.std(gyro)), _used(tones, own_axis),
            jnp.asarray(displacement), jnp.asarray(force), jnp.asarray(band), jnp.asarray(1.0 / sample_rate),
            setting.samples, readout.signals, setting.rate_index,
        )  # fmt: skip
        best = search(problem, modes(gyro), starts, steps, seed)
        if not best.losses[0] < math.log(_USELESS):
            raise InputError(
                f"Argument `tones` must be enough for all that is unknown, but {tones} leave the rate undetermined; "
                "add tones, or name what is `known`."
            )
        agreeing = int(np.sum(best.losses < best.losses[0] + _ALIKE))
        omega, amplitude = (np.asarray(part[0])[:tones] for part in best.tones)
        return finished(omega / (2.0 * np.pi), amplitude, setting, errors, starts, agreeing)

    nominal = found(ModelErrors.none())
    return nominal if not np.any(errors.std(gyro)) else replace(found(errors), nominal=nominal)


def _check(setting: Setting, band: tuple[float, float]) -> None:
    for name in ("displacement", "sample_rate", "duration"):
        check_positive(name, getattr(setting, name))
    if not setting.force > 0.0:
        raise InputError(f"Argument `force` must be positive, but {setting.force:g} was given.")
    count_steps(setting.sample_rate, setting.duration)
    if not 0.0 < band[0] < band[1] < 0.5 * setting.sample_rate:
        raise InputError(
            f"Argument `band` must be two rising frequencies below half the sample rate of {setting.sample_rate:g} Hz, "
            f"but {band[0]:g} and {band[1]:g} Hz were given."
        )
    names = [name for name in setting.own if name != "rate"]
    for name in setting.known:
        if name not in names:
            raise InputError(f"Argument `known` must name some of {', '.join(names)}, but holds `{name}`.")
    if any(float(v) <= 0.0 for v in setting.readout.noise_density):
        raise InputError(
            "The read-out must have noise on both axes for a bound to exist, but a `noise_density` of 0 was given."
        )


def _used(tones: int, own_axis: bool) -> Float[np.ndarray, "slots 2"]:
    used = np.zeros((-(-tones // _SLOTS) * _SLOTS, 2))
    used[:tones] = np.eye(2)[np.arange(tones) % 2] if own_axis else 1.0
    return jnp.asarray(used)


def _drawn(setting: Setting, spread: Spread, dies: int, seed: int) -> list[AbstractGyro]:
    """The devices of a lot, one by one."""
    observer = ExtendedKalmanFilter.for_device(setting.gyro, setting.readout)
    loop = ClosedLoop(setting.gyro, setting.readout, observer, OpenLoop())
    drawn = spread.draw(loop, as_scenario(setting.rate), seed, np.arange(dies)).loop.device
    pick = lambda i: jax.tree.map(lambda v, one: v[i] if jnp.ndim(v) > jnp.ndim(one) else v, drawn, setting.gyro)  # noqa: E731
    return [pick(i) for i in range(dies)]
