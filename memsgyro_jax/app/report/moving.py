"""The orbit of the mass and its mode shapes as one SVG that moves by itself, without a script."""

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import scipy.linalg
from jaxtyping import Float
from markupsafe import Markup, escape

from memsgyro_jax.device.gyro import Inertial, mode_frequencies
from memsgyro_jax.loop.trace_result import ORBIT


if TYPE_CHECKING:
    from memsgyro_jax.loop.trace_result import Trace

_SIDE, _GAP, _TOP = 260.0, 44.0, 26.0  # of a panel, between two, above: units of the picture
_FULL = 0.45  # of a side, that the largest displacement takes
_SLOW = 1.0  # s on the screen for one vibration
_ROWS = 1200  # points of a path at most
_PER_PERIOD = 8  # rows that a vibration needs to be seen


class _Panel(NamedTuple):
    """A path in units of `scale`, y upwards, how long it takes, and whether the picture of it is a closed line."""

    title: str
    path: Float[np.ndarray, "rows 2"]
    scale: str
    seconds: float


def orbit_of(trace: "Trace") -> Markup | str:
    """The picture of a run: the mass over its last vibrations, then its two mode shapes; or why there is none."""
    frequency = np.ravel(mode_frequencies(trace.loop.device))
    if trace.lost_at is not None:
        return "The orbit is not shown: the die was lost."
    path, title = trace.last_vibrations()[:, :2], "orbit"
    kept = (len(trace.time) - 1) / max(float(trace.time[-1] - trace.time[0]), 1e-300)
    if kept < _PER_PERIOD * frequency[-1]:  # too few rows to see a vibration
        kept, title = 4.0 * _PER_PERIOD * frequency[-1], "orbit, going on from the last row"
        path = _going_on(trace, 1.0 / kept, int(ORBIT * kept / frequency[0]))
    largest = float(np.max(np.abs(path)))
    if not largest > 0.0:
        return "The orbit is not shown: the mass did not move."
    span = float(len(path) / kept) * frequency[0]
    panels = [_Panel(title, path / largest, f"largest displacement {1e6 * largest:.4g} µm", _SLOW * span)]
    phase = np.linspace(0.0, 2.0 * np.pi, 41)
    for number, shape in enumerate(mode_shapes(trace)):
        title = f"mode {number + 1}, {frequency[number]:.5g} Hz"
        turn = frequency[0] / frequency[number]
        panels.append(_Panel(title, np.outer(np.cos(phase), shape), f"{_angle(shape):.3g}° from x", _SLOW * turn))
    return picture(panels)


def _going_on(trace: "Trace", step: float, count: int) -> Float[np.ndarray, "count 2"]:
    """Where the mass would swing from the last row on in steps of `step` [s]: its linear part, without a force."""
    dynamics, eye = trace.loop.device.dynamics(Inertial()), np.eye(2)
    stiffness, velocity = (np.array([[float(c) for c in row] for row in part])
                           for part in (dynamics.stiffness, dynamics.velocity))  # fmt: skip
    onward = scipy.linalg.expm(step * np.block([[0.0 * eye, eye], [-stiffness, -velocity]]))
    motion = [np.asarray(trace.motion[-1], float)]
    for _ in range(count - 1):
        motion.append(onward @ motion[-1])
    return np.array(motion)[:, :2]


def mode_shapes(trace: "Trace") -> Float[np.ndarray, "modes 2"]:
    """Directions of the undamped modes at rest in the plane of x and y, each of length one, the slowest first."""
    value, vector = np.linalg.eig([[float(k) for k in row] for row in trace.loop.device.dynamics(Inertial()).stiffness])
    shapes = np.real(vector[:, np.argsort(np.real(value))]).T
    return shapes * np.where(shapes[:, :1] < 0.0, -1.0, 1.0)


def _angle(shape: Float[np.ndarray, "2"]) -> float:
    return float(np.degrees(np.arctan2(shape[1], shape[0])))


def picture(panels: list[_Panel]) -> Markup:
    """Panels side by side, each a path with a dot that runs along it for ever; in print and where motion is unwanted
    the path alone.
    """
    width = len(panels) * (_SIDE + _GAP) - _GAP + 8.0
    drawn = Markup("").join(_panel(4.0 + number * (_SIDE + _GAP), panel) for number, panel in enumerate(panels))
    return Markup(
        '<svg class="moving" viewBox="0 0 {} {}" font-family="sans-serif" font-size="13" fill="#1d2530">{}</svg>'
    ).format(f"{width:g}", f"{_TOP + _SIDE + 24.0:g}", drawn)


def _panel(left: float, panel: _Panel) -> Markup:
    points = panel.path[:: max(1, -(-len(panel.path) // _ROWS))]
    x, y = left + _SIDE * (0.5 + _FULL * points[:, 0]), _TOP + _SIDE * (0.5 - _FULL * points[:, 1])
    path = "M" + "L".join(f"{a:.1f},{b:.1f}" for a, b in zip(x, y, strict=True))
    middle, across = left + 0.5 * _SIDE, _TOP + 0.5 * _SIDE
    return Markup(
        '<text x="{left}" y="16">{title}</text>'
        '<path d="M{left},{across}h{side}M{middle},{top}v{side}" stroke="#b8c0ca" stroke-width="1"/>'
        '<path d="{path}" fill="none" stroke="#3b6fb6" stroke-width="1.2"/>'
        '<circle class="mass" r="6" fill="#c2502e"><animateMotion dur="{seconds}s" repeatCount="indefinite" '
        'path="{path}"/></circle>'
        '<text x="{right}" y="{beside}" text-anchor="end">x</text><text x="{over}" y="{upper}">y</text>'
        '<text x="{left}" y="{below}" fill="#5b6673">{scale}</text>'
    ).format(
        left=f"{left:g}", title=escape(panel.title), across=f"{across:g}", side=f"{_SIDE:g}", middle=f"{middle:g}",
        top=f"{_TOP:g}", path=path, seconds=f"{panel.seconds:.3g}", right=f"{left + _SIDE:g}",
        beside=f"{across - 5.0:g}", over=f"{middle + 5.0:g}", upper=f"{_TOP + 11.0:g}",
        below=f"{_TOP + _SIDE + 16.0:g}", scale=escape(panel.scale),
    )  # fmt: skip
