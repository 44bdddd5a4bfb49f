"""What a fit of sweeps tells, each number with its standard deviation and a verdict whether the sweeps hold it."""

from collections.abc import Mapping, Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from .doubts import would_help
from .frequency_sweep import FrequencySweep
from .modal import SingleMode, coupled_poles
from .result import CouplingCoefficient
from .sense_view import SeenBench
from .tree_fit import Fit


NOT_HELD = "not determined"
_Estimate = tuple[np.ndarray, np.ndarray]


def _products(seen: SeenBench) -> jnp.ndarray:
    """|ρ|·(λyx, cxy, kxy) per unit mass and λxy/|ρ|, ρ = gain ratio · e^{i asymmetry}: what the sense channel shows."""
    coupling = (seen.coupling[0] + 1j * seen.coupling[1]) * jnp.exp(-1j * seen.readout.phase_asymmetry)
    return jnp.stack([seen.force_yx, seen.force_xy, coupling.imag / seen.omega[0], coupling.real])


def _modes(seen: SeenBench) -> jnp.ndarray:
    coupled = SingleMode.of_pole(coupled_poles(seen.device))
    turns = jnp.stack([seen.omega, coupled.omega]) / (2 * jnp.pi)
    return jnp.stack([turns, jnp.stack([seen.quality, coupled.quality])], axis=1)


def estimates(outcome: Fit) -> dict[str, _Estimate]:
    """Value and standard deviation of everything reported."""
    return jax.tree.map(np.asarray, _estimates(outcome))


@eqx.filter_jit
def _estimates(outcome: Fit) -> dict[str, tuple[jnp.ndarray, jnp.ndarray]]:
    """The same, in one compiled function."""
    functions = {
        "couplings": lambda seen: seen.couplings,
        "products": _products,
        "modal": _modes,
        "readout": lambda seen: jnp.stack([seen.readout.gain_ratio, jnp.rad2deg(seen.readout.phase_asymmetry)]),
    }
    seen = outcome.values
    if seen.sweep_rate is not None:
        functions["sweep_speed"] = lambda seen: seen.sweep_rate.strength / (2 * jnp.pi)
    if seen.delay is not None:
        functions["readout_delay"] = lambda seen: seen.delay.strength
    if seen.offsets is not None:
        functions["frequency_offset"] = lambda seen: seen.offsets
    if seen.feedthrough is not None and seen.feedthrough.x_drive is not None:
        functions["x_leak"] = lambda seen: seen.feedthrough.x_drive
    if seen.feedthrough is not None and seen.feedthrough.y_drive is not None:
        functions["y_leak"] = lambda seen: seen.feedthrough.y_drive
    return {name: (function(seen), outcome.std_of(function)) for name, function in functions.items()}


def coefficients(
    estimate: _Estimate,
    outcome: Fit,
    sweeps: Sequence[FrequencySweep],
    mass: float | None,
    doubt: str,
) -> dict[str, CouplingCoefficient]:
    """The couplings with their verdicts; `doubt` is why none can be trusted, or empty."""
    scale = np.array([1.0, 1.0, mass or 1.0, mass or 1.0])
    value, std = (part * scale for part in estimate)
    device = outcome.values.device
    # What each could be at most: λ of order one, |cxy| ≤ √(cxx·cyy), |kxy| ≤ √(kxx·kyy).
    ceiling = scale * np.array([1.0, 1.0, np.sqrt(np.prod(device.omega / device.quality)), np.prod(device.omega)])
    units = ("1", "1", "N*s/m", "N/m") if mass else ("1", "1", "1/s", "1/s^2")
    axes = {sweep.axis for sweep in sweeps}
    out = {}
    for i, name in enumerate(("lambda_yx", "lambda_xy", "c_xy", "k_xy")):
        if i < 2 and i not in axes:
            electrode = "xy"[i]
            out[name] = CouplingCoefficient(
                None, None, units[i], f"not identified by this sweep: drive the {electrode} electrode too"
            )
        elif not std[i] < ceiling[i]:
            out[name] = CouplingCoefficient(
                None, None, units[i], doubt or f"not identified by this sweep: {would_help(outcome, sweeps)}"
            )
        else:
            verdict = doubt or _verdict(value[i], std[i], ceiling[i], lambda: would_help(outcome, sweeps))
            out[name] = CouplingCoefficient(float(value[i]), float(std[i]), units[i], verdict)
    return out


def _verdict(value: float, std: float, ceiling: float, advice) -> str:
    """Identified to a tenth, roughly, bounded near zero, or not at all."""
    if not std < 0.1 * ceiling:
        return f"not identified by this sweep: {advice()}"
    if std <= 0.1 * abs(value):
        return "identified"
    if std <= abs(value) / 3:
        return f"identified roughly (± {100 * std / abs(value):.0f} %)"
    return f"not distinguishable from zero (|value| below {abs(value) + 2 * std:.2g} at 95 %)"


def modal(value: np.ndarray, std: np.ndarray) -> dict[str, CouplingCoefficient]:
    """Both modes, uncoupled and as resonances."""
    out = {}
    for axis, letter in enumerate("xy"):
        for i, (label, what) in enumerate((("", "uncoupled axis"), ("pole_", "coupled resonance"))):
            for k, (name, unit) in enumerate((("f", "Hz"), ("q", "1"))):
                number, spread = value[i, k, axis], std[i, k, axis]
                out[f"{label}{name}_{letter}"] = _held(number, spread, abs(number), unit, what)
    return out


def channel_values(value: np.ndarray, std: np.ndarray) -> dict[str, CouplingCoefficient]:
    """Gain ratio and phase asymmetry of the channels; each of them has no value where the sweeps leave it open."""
    return {
        "gain_ratio": _held(value[0], std[0], value[0], "1", "sense over drive channel"),
        "phase_asymmetry_deg": _held(value[1], std[1], 90.0, "deg", "sense less drive channel"),
    }


def products(estimate: _Estimate, sweeps: Sequence[FrequencySweep], mass: float | None) -> dict:
    """What the sense channel shows of the couplings where the gain ratio is not known: of each that the sweeps hold."""
    value, std = (part * np.array([1.0, 1.0, mass or 1.0, mass or 1.0]) for part in estimate)
    axes = {sweep.axis for sweep in sweeps}
    names = ("gain_ratio*lambda_yx", "lambda_xy/gain_ratio", "gain_ratio*c_xy", "gain_ratio*k_xy")
    units = ("1", "1", "N*s/m", "N/m") if mass else ("1", "1", "1/s", "1/s^2")
    return {
        name: CouplingCoefficient(float(value[i]), float(std[i]), units[i], "held without the gain ratio")
        for i, name in enumerate(names)
        if std[i] < abs(value[i]) and (i > 1 or i in axes)
    }


def _held(value: float, std: float, most: float, unit: str, what: str) -> CouplingCoefficient:
    """A number whose standard deviation stays below `most`; beyond that it says nothing."""
    if not std < most:
        return CouplingCoefficient(None, None, unit, f"{what}, {NOT_HELD} by these sweeps")
    return CouplingCoefficient(float(value), float(std), unit, what)


def effect_values(
    estimates: Mapping[str, _Estimate], sweeps: Sequence[FrequencySweep]
) -> dict[str, CouplingCoefficient]:
    """What the effects that were modelled beyond two linear modes came to."""
    out = {}
    if "readout_delay" in estimates:
        value, std = estimates["readout_delay"]
        out["readout_delay"] = CouplingCoefficient(float(value), float(std), "s", "of both channels")
    if "sweep_speed" in estimates:
        value, std = estimates["sweep_speed"]
        out["sweep_speed"] = CouplingCoefficient(float(value), float(std), "Hz/s", "finite_sweep_rate")
    for sweep, value, std in zip(sweeps[1:], *estimates.get("frequency_offset", ((), ())), strict=False):
        what = f"of the frequencies in {sweep.name} over those in {sweeps[0].name}"
        out[f"frequency_offset_{sweep.number + 1}"] = CouplingCoefficient(float(value), float(std), "1", what)
    for axis in "xy":
        if f"{axis}_leak" not in estimates:
            continue
        value, std = estimates[f"{axis}_leak"]
        for channel, part in np.ndindex(2, 2):
            name = f"leak_{'xy'[channel]}_{'IQ'[part]}_{axis}_driven"
            out[name] = CouplingCoefficient(
                float(value[channel, part]),
                float(std[channel, part]),
                "1",
                "electrical_feedthrough, record unit per drive",
            )
    return out
