"""The response of a loop over frequency: what a simulation of a small sine shows on average, taken exactly as the
derivative of the run by the size of the sine.
"""

from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Complex, Float

from memsgyro_jax.base import runtime
from memsgyro_jax.base.arguments import plain_quantity, quantities, quantity
from memsgyro_jax.base.axes import axes
from memsgyro_jax.base.concrete import is_concrete, settled
from memsgyro_jax.base.errors import InputError
from memsgyro_jax.base.files import finite
from memsgyro_jax.base.labelled import Tabular, labelled

from .further import Response, around_split, half_power_bracket, looked_further
from .linearised import INPUTS, disturbed, known_array
from .loop import ClosedLoop, as_loop
from .scenario import Scenario, as_scenario
from .trace import count_steps


if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.axes import Axes


_RESTLESS = 0.01  # of an answer, from which the rest of it is told
_HIGHER = 1.05  # times all that is shown, from which a peak between it is told


@dataclass(frozen=True, eq=False, repr=False)
class FrequencyResponse(Tabular):
    """How the rate that a loop gives out answers a small sine of one of its `INPUTS`.

    `response` is the complex ratio over `frequency` [Hz], in rad/s per unit of the input, a phase that lags negative;
    `rest` the part of the answer, relative, that is no sine of that frequency: what had not settled, or beats with the
    swing. `level` is the constant rate [rad/s] around which it was taken. With a `carrier` [Hz] the sine is that of the
    amplitude of an oscillation at this frequency, in the phase that the loop answers most. `static` is the response to
    a small change that stays, of the rate or of that amplitude, None of another disturbance.

    `further` are frequencies, responses and rests of those and of more where half the power, or a peak between them,
    was looked for; None where there are no more. `lost_at` is the time [s] at which the loop was lost even without the
    sine, out of travel or not finite, None where it was not: a response of a lost loop is NaN.
    """

    disturbance: str
    frequency: Float[np.ndarray, " frequencies"]
    response: Complex[np.ndarray, " frequencies"]
    rest: Float[np.ndarray, " frequencies"]
    level: float
    static: complex | None = None
    carrier: float | None = None
    further: Response | None = None
    lost_at: float | None = None
    along: ClassVar[str] = "frequency"

    @property
    def bandwidth(self) -> float:
        """The frequency in Hz at which the power has halved from that of a constant rate, or of the lowest frequency
        where another disturbance was asked for; NaN where it does not, has before the lowest frequency, or is unknown.
        """
        frequency, response, _ = self._all
        power = known_array((jnp.abs(response) / jnp.abs(self._whole)) ** 2)
        k = half_power_bracket(np.sqrt(np.asarray(settled(power))))
        if k is None:
            return float("nan")
        xp, (before, behind) = np if is_concrete(power) else jnp, frequency[k - 1 : k + 1]
        share = xp.log(power[k - 1] / 0.5) / xp.log(power[k - 1] / power[k])
        return _number(before * (behind / before) ** share)

    @property
    def peak(self) -> tuple[float, float]:
        """The frequency in Hz that is answered most of all looked at, and the gain there; NaN of no answer."""
        frequency, gain = self._all[0], np.abs(self._all[1])
        if not np.all(np.isfinite(gain)):
            return float("nan"), float("nan")
        return float(frequency[np.argmax(gain)]), float(np.max(gain))

    @property
    def _all(self) -> Response:
        return (self.frequency, self.response, self.rest) if self.further is None else self.further

    @property
    def _whole(self) -> Any:
        return self.response[0] if self.static is None else self.static

    @property
    def headline(self) -> str:
        """What the response is of and where its power has halved, or that its loop was lost."""
        about = f"Response of the rate to {self.disturbed} ({self._unit})"
        if self.lost_at is not None:
            return f"{about}: none, as the loop was lost at {self.lost_at:.4g} s (out of travel or not finite)"
        if not np.all(np.isfinite(self.response)):
            return f"{about}: none, as it is not finite"
        return f"{about}, {self._halved}"

    @property
    def _halved(self) -> str:
        low, whole = self.frequency[0], f"{self.frequency[0]:.4g} Hz"
        if self.static is not None:
            whole = "a constant rate" if self.carrier is None else "a constant one"
        half, first = f"half the power of {whole}", abs(self.response[0])
        if np.isfinite(self.bandwidth):
            return f"{half} at {self.bandwidth:.4g} Hz{self._resonance}"
        if self.static is not None and first**2 < 0.5 * abs(self.static) ** 2:
            return f"{half} below {low:.4g} Hz already: ask for lower frequencies too"
        return f"{half} nowhere up to {self.frequency[-1]:.4g} Hz{self._resonance}"

    @property
    def _resonance(self) -> str:
        """Words for a peak of more than twice the power of a constant rate, that is no end of what was looked at."""
        at, gain = self.peak
        if not gain > np.sqrt(2.0) * abs(self._whole) or at in (self._all[0][0], self._all[0][-1]):
            return ""
        return f", a peak of {gain / abs(self._whole):.4g} times at {at:.4g} Hz"

    def __str__(self) -> str:
        if not np.all(np.isfinite(self.response)):
            return self.headline
        phase = np.degrees(np.unwrap(np.angle(self.response)))
        rows = zip(self.frequency, np.abs(self.response), phase, self.rest, strict=True)
        lines = [
            self.headline,
            *(f"  {f:>10.4g} Hz  {gain:>10.4g}  {angle:>8.1f}°  rest {rest:.1e}" for f, gain, angle, rest in rows),
            *(f"  {note}" for note in self.notes),
        ]
        return "\n".join(lines)

    @property
    def notes(self) -> tuple[str, ...]:
        """What a reader of its rows must know: of a peak between them, and of what is no such sine."""
        found, (at, gain), shown = [], self.peak, np.max(np.abs(self.response))
        if gain > _HIGHER * shown:
            found.append(
                f"a peak of {gain:.4g} at {at:.4g} Hz lies between these frequencies, which show {shown:.4g} at most"
            )
        if np.max(self.rest) > _RESTLESS:
            found.append(
                f"up to {np.max(self.rest):.2g} of the answer is no such sine: what the start or the swing left "
                "there; a longer `duration` or a later `settle` shows whether it dies away"
            )
        return tuple(found)

    @property
    def disturbed(self) -> str:
        """What the sine is of, in words."""
        carried = "" if self.carrier is None else f" at {self.carrier:.5g} Hz, by its amplitude"
        return f"{self.disturbance}{carried}"

    @property
    def _unit(self) -> str:
        return "1" if self.disturbance == "rate" else f"rad/s/{INPUTS[self.disturbance]}"

    def to_xarray(self) -> "xr.Dataset":
        """Gain, phase and rest over `frequency`."""
        variables = {
            "gain": ("frequency", np.abs(self.response), self._unit),
            "phase": ("frequency", np.unwrap(np.angle(self.response)), "rad"),
            "rest": ("frequency", self.rest, "1", "part of the answer that is no sine of the frequency"),
        }
        about = {"disturbance": self.disturbed, "bandwidth": self.bandwidth, "rate": self.level}
        return labelled(self, variables, {"frequency": ("frequency", self.frequency, "Hz")}, about)

    def as_dict(self) -> dict[str, Any]:
        """Entries for JSON, degrees and Hz; null where there is no number."""
        phase = np.degrees(np.unwrap(np.angle(self.response)))
        told = {"frequency_hz": self.frequency, "gain": np.abs(self.response), "phase_deg": phase, "rest": self.rest}
        about = {"disturbance": self.disturbed, "unit": self._unit, "bandwidth_hz": float(self.bandwidth)}
        about |= {"lost_at_s": self.lost_at, "peak": dict(zip(("frequency_hz", "gain"), self.peak, strict=True))}
        return finite({**about, **{name: np.asarray(values).tolist() for name, values in told.items()}})

    def plot(self, ax: "Axes | None" = None) -> "Axes":
        """Bode diagram: gain in dB with dots where it was asked for, and the phase dashed on an axis at the right;
        returns the axes of the gain.
        """
        ax, (frequency, response, _) = axes(ax), self._all
        ax.semilogx(frequency, 20.0 * np.log10(np.abs(response)), color="C0")
        ax.semilogx(self.frequency, 20.0 * np.log10(np.abs(self.response)), color="C0", marker=".", ls="")
        ax.set(xlabel="frequency [Hz]", ylabel=f"gain [dB of {self._unit}]")
        right = ax.twinx()
        phase = np.degrees(np.unwrap(np.angle(response)))
        right.semilogx(frequency, phase, color="C1", ls="--", label="phase")
        right.set_ylabel("phase [°]")
        right.plot([], [], color="C0", marker=".", label="gain")
        right.legend(loc="best", frameon=False)
        ax.xaxis.set_major_formatter("{x:g}")
        ax.xaxis.set_minor_formatter("")
        return ax


def frequency_response(
    loop: ClosedLoop,
    frequency: Float[np.ndarray, " frequencies"],
    disturbance: str = "rate",
    *,
    sample_rate: float | str,
    duration: float | str,
    settle: float | str | None = None,
    level: float | str = 0.0,
    carrier: float | str | None = None,
) -> FrequencyResponse:
    """The Bode diagram of any loop, linear or not: the derivative of a run without noise by the size of a small sine.

    Args:
        loop: whatever it is made of.
        frequency: of the sines [Hz, or texts], rising; each has its own run, side by side. Between them more are run
            where half the power, or a peak, lies there.
        disturbance: one of `INPUTS`.
        sample_rate, duration: of the runs, Hz and s.
        settle: from when on the answer is taken [s]; half the duration without.
        level: the constant rate [rad/s] around which the rate is disturbed.
        carrier: where given [Hz], the sine is that of the amplitude of an oscillation at this frequency, of the phase
            that the loop answers most: a force or voltage beside the swing, which slow ones do not reach. That of the
            swing is `noise_budget(loop).swing`. It is held over each sample, which makes it weaker by sin(z)/z, z = π
            times carrier over sample rate.

    **Raises:** `InputError` for another name, for frequencies that do not rise between one in the settled part and half
    the sample rate, and as `simulate` does.
    """
    runtime.require_float64("frequency_response")
    loop, level = as_loop(loop), quantity("level", level, "rad/s")
    sample_rate, duration = plain_quantity("sample_rate", sample_rate, "Hz"), plain_quantity("duration", duration, "s")
    settle = 0.5 * duration if settle is None else quantity("settle", settle, "s")
    steps, frequency = count_steps(sample_rate, duration), quantities("frequency", frequency, "Hz")
    if disturbance not in INPUTS:
        raise InputError(f"Argument `disturbance` must be one of {', '.join(INPUTS)}, but is `{disturbance}`.")
    check_frequencies(frequency, sample_rate, duration - settle)
    loop = loop.sampled_at(sample_rate, duration=duration).present
    place = list(INPUTS).index(disturbance)
    start = round(settle * sample_rate)
    carrier = None if carrier is None else quantity("carrier", carrier, "Hz")
    phases = jnp.zeros(1) if carrier is None else jnp.array([0.0, -0.5 * np.pi])
    carried = jnp.asarray(2.0 * np.pi * (0.0 if carrier is None else carrier))
    period, scenario = 1.0 / sample_rate, as_scenario(level)

    def answers(frequency: Any) -> tuple[Any, Any]:
        """Responses and rests, and of a constant last."""
        omega = jnp.asarray(2.0 * np.pi * np.append(frequency, 0.0))
        parts = _answers(loop, scenario, period, steps, start, omega, place, carried, phases)
        return _strongest(*map(known_array, parts))

    found, rest = answers(frequency)
    static = found[-1] if disturbance == "rate" or carrier is not None else None
    known, lost_at = (frequency, found[:-1], rest[:-1]), _lost_at(loop, scenario, period, steps)
    if lost_at is not None:
        known, static = (frequency, np.full(frequency.shape, np.nan + 0j), np.full(frequency.shape, np.nan)), None
    further = known
    if lost_at is None and is_concrete(settled(known)):
        first = around_split(loop.device, frequency[0], frequency[-1])
        further = looked_further(answers, known, known[1][0] if static is None else static, first)
    more = None if further is known else further
    return FrequencyResponse(disturbance, *known, level, static, carrier, more, lost_at)


def _lost_at(loop: ClosedLoop, scenario: Scenario, period: float, steps: int) -> float | None:
    """When [s] the loop is lost without a disturbance; None where it is not, and inside `vmap` and `jit`."""
    lost = settled(_lost(loop, scenario, period, steps))
    if not is_concrete(lost) or not np.any(np.asarray(lost)):
        return None
    return float(period * (1 + np.argmax(np.asarray(lost))))


@eqx.filter_jit
def _lost(loop: ClosedLoop, scenario: Scenario, period: float, steps: int) -> Array:
    def told(sample: Any) -> Array:
        far = jnp.maximum(*map(jnp.abs, sample.motion[:2]))
        return ~((far <= loop.travel) & jnp.isfinite(sum(sample.motion) + sample.rate))

    return disturbed(loop, scenario, loop.init(), 0, steps, period, lambda _: jnp.zeros(len(INPUTS)), told)[1]


def check_frequencies(frequency: Float[np.ndarray, " f"], sample_rate: float, settled: float) -> None:
    """Raises `InputError` unless frequencies [Hz] rise from a period of `settled` seconds to half a sample rate."""
    slowest, rising = 1.0 / max(settled, 1e-300), np.all(np.diff(frequency) > 0.0)
    if not (rising and slowest <= frequency[0] and frequency[-1] < 0.5 * sample_rate):
        raise InputError(
            f"Argument `frequency` must rise from at least {slowest:.4g} Hz (a period in the settled part) to below "
            f"{0.5 * sample_rate:.4g} Hz, but goes from {frequency[0]:.4g} to {frequency[-1]:.4g} Hz; a longer "
            "`duration` allows lower ones."
        )


def _strongest(found: Any, rest: Any) -> tuple[Any, Any]:
    """Answers and rests (phases, frequencies) of the phase of the carrier that a constant amplitude is answered most
    in, the answer to it positive.
    """
    if len(found) == 1:
        return found[0], rest[0]
    xp = np if is_concrete(found) else jnp
    parts = found[:, -1].real / xp.hypot(*found[:, -1].real)
    whole = parts @ found
    return whole, xp.hypot(*(parts[:, None] * rest * xp.abs(found))) / xp.abs(whole)


def _number(value: Any) -> Any:
    return float(value) if is_concrete(value) else value


@eqx.filter_jit
def _answers(
    loop: ClosedLoop, scenario: Scenario, period: float, steps: int, start: int, omega: Array, place: int,
    carrier: Array, phases: Array,
) -> tuple[Array, Array]:  # fmt: skip
    def output(size: Array, omega: Array, phase: Array) -> Array:
        def at(time: Array) -> Array:
            wave = jnp.where(omega > 0.0, jnp.sin(omega * time), 1.0) * jnp.cos(carrier * time + phase)
            return jnp.zeros(len(INPUTS)).at[place].set(size * wave)

        return disturbed(loop, scenario, loop.init(), 0, steps, period, at)[1][:, 0]

    def answer(omega: Array, phase: Array) -> tuple[Array, Array]:
        tangent = jax.jvp(partial(output, omega=omega, phase=phase), (jnp.zeros(()),), (jnp.ones(()),))[1][start:]
        angle = omega * period * (start + 1.0 + jnp.arange(tangent.size))
        # A slow drift is what has not settled, and no part of the sine.
        basis = jnp.stack([jnp.sin(angle), jnp.cos(angle), jnp.ones_like(angle), angle - angle[0]], axis=1)
        parts = jnp.linalg.lstsq(basis, tangent)[0]
        left = tangent - basis[:, :2] @ parts[:2]
        size = jnp.sqrt(jnp.mean((basis[:, :2] @ parts[:2]) ** 2))
        gain = jnp.where(omega > 0.0, parts[0] + 1j * parts[1], jnp.mean(tangent) + 0.0j)
        return gain, jnp.sqrt(jnp.mean(left**2)) / size

    return jax.vmap(lambda phase: jax.vmap(lambda each: answer(each, phase))(omega))(phases)
