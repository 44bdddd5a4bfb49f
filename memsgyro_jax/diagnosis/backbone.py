"""Frequency and damping of an axis against its amplitude, and the forces behind them, as far as they were seen.

Every row of a sweep obeys (K(a) − ω² + iωD(a))·x = g·u with the phasors x of its displacement and u of its force. That
is linear in the gain g and, for forces drawn as straight lines between knots, in the values there, so that one
least-squares problem holds every row of every sweep and every stretch of a decay. No law is assumed, and nothing of the
fit but what its instrument makes of the readings. K and D of a force are its describing functions: Krylov and
Bogoliubov, "Introduction to Non-Linear Mechanics", Princeton (1947).
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr

from memsgyro_jax.base.arguments import check_kind
from memsgyro_jax.base.display import Shown
from memsgyro_jax.base.errors import InputError
from memsgyro_jax.measurement.calibration import bracketed, length_of_records

from .fit import CaseFit
from .residual_force import sweep_forces


if TYPE_CHECKING:
    from matplotlib.axes import Axes


KNOTS = 9  # between which a force is drawn
REACH = 30.0  # largest amplitude over the lowest knot but zero
ROUNDS = 6  # of weighting by what was left
FLOOR = 0.01  # of the force: what settings and drifts leave uncertain of any row
OUTLYING = 4.0  # robust standard deviations from which a row loses weight
FEWEST = 12  # real equations below which nothing is drawn
ANGLES = (np.arange(64) + 0.5) * np.pi / 128  # of a quarter of a cycle
CONSTANT = slice(2, 4)  # of the nuisances of a sweep's rows: a constant reading, in phase and in quadrature
_NORMAL = 1.4826


def describing(share: Callable[[np.ndarray], np.ndarray], size: np.ndarray) -> np.ndarray:
    """Describing function (k,) of a force share(|z|)·z at amplitudes `size` (k,) of z."""
    swing = np.abs(np.cos(ANGLES))
    return np.asarray(2.0 * np.mean(share(size[:, None] * swing) * swing**2, axis=1))


@dataclass(frozen=True, eq=False)
class Equations:
    """Rows of all records as real equations that are linear in describing functions, in units of their noise.

    Args:
        amplitude, omega: of each row (n,) [m], [rad/s].
        stiffness, damping: what multiplies the missing stiffness and damping per mass there (n, 2) each.
        others: what multiplies the nuisances (n, 2, c).
        target: right side (n, 2).
        record: name of each row's record (n,).
        drive: of each row (n,) [N], zero in a decay.
    """

    amplitude: np.ndarray
    omega: np.ndarray
    stiffness: np.ndarray
    damping: np.ndarray
    others: np.ndarray
    target: np.ndarray
    record: np.ndarray
    drive: np.ndarray

    def columns(self, stiffness: np.ndarray, damping: np.ndarray) -> np.ndarray:
        """Left side (2n, s + d + c) for describing functions of stiffness (n, s) and damping (n, d) at each row."""
        left = self.stiffness[:, :, None] * stiffness[:, None], self.damping[:, :, None] * damping[:, None]
        whole = np.concatenate([*left, self.others], axis=2)
        return whole.reshape(-1, whole.shape[2])

    def solve(self, columns: np.ndarray, weight: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Solution, its covariance as the scatter of the rows has it, and what is left (2n,)."""
        left, right = columns * weight[:, None], self.target.ravel() * weight
        size = np.linalg.norm(left, axis=0)
        size = np.where(size > 0, size, 1.0)
        found = np.linalg.lstsq(left / size, right, rcond=1e-10)[0]
        rest = right - left / size @ found
        freedom = max(1.0, float(np.sum(weight > 0)) - columns.shape[1])
        inverse = np.linalg.pinv((left / size).T @ (left / size), rcond=1e-14)
        covariance = inverse / size / size[:, None] * max(1.0, float(rest @ rest) / freedom)
        return found / size, covariance, self.target.ravel() - columns @ (found / size)

    def robust(self, columns: np.ndarray) -> np.ndarray:
        """Weights (2n,) that leave little of rows far off, such as those in the middle of a jump."""
        weight = np.ones(self.target.size)
        for _ in range(ROUNDS):
            rest = np.linalg.norm(self.solve(columns, weight)[2].reshape(-1, 2), axis=1)
            level = OUTLYING * max(_NORMAL * float(np.median(rest)), 1e-300)
            weight = np.repeat(1.0 / np.maximum(1.0, rest / level) ** 2, 2)
        return weight


@dataclass(frozen=True, eq=False, repr=False)
class Backbone(Shown):
    """An axis at rest and in motion.

    Args:
        case, axis: of which device, 0 = x, 1 = y.
        amplitude: grid within what was seen (k,) in `length`.
        omega, omega_std: angular frequency of its free vibration there (k,) [rad/s].
        damping, damping_std: damping per mass there, twice the decay rate of the amplitude (k,) [1/s].
        displacement, restoring, restoring_std: the whole force of the spring over displacement (k,) in `length`.
        velocity, dissipative, dissipative_std: the whole force of the damper over velocity (k,) in `length`/s.
        points: what each row shows by itself: amplitude, angular frequency and damping (n, 3).
        records: name of each point's record (n,).
        least: displacement and velocity below which the forces are not seen: they extrapolate towards rest.
        scatter: root mean square of what is left of the rows over their noise.
        length, force: units of displacements and forces: those of the records where nothing calibrates them.
    """

    case: str
    axis: int
    amplitude: np.ndarray
    omega: np.ndarray
    omega_std: np.ndarray
    damping: np.ndarray
    damping_std: np.ndarray
    displacement: np.ndarray
    restoring: np.ndarray
    restoring_std: np.ndarray
    velocity: np.ndarray
    dissipative: np.ndarray
    dissipative_std: np.ndarray
    points: np.ndarray
    records: np.ndarray
    least: tuple[float, float]
    scatter: float
    length: str = "m"
    force: str = "N"

    @property
    def hardening(self) -> tuple[float, float]:
        """Slope of the squared frequency over the squared amplitude, over that at rest, times 4/3, and its standard
        deviation [1/`length`²]: k3/k1 of a cubic spring, and what several terms amount to together.
        """
        top, weight = self.amplitude[-1], 1.0 / np.maximum(2 * self.omega * self.omega_std, 1e-300)
        square = (self.amplitude / top) ** 2
        left = np.stack([np.ones_like(square), square], axis=1) * (weight / weight.max())[:, None]
        right = self.omega**2 * weight / weight.max()
        found = np.linalg.lstsq(left, right)[0]
        freedom = max(1, len(square) // (len(square) // KNOTS) - 2)  # the curve has no more numbers than knots
        rest = float(np.sum((right - left @ found) ** 2)) / len(square) * KNOTS / freedom
        spread = np.sqrt(np.linalg.inv(left.T @ left * KNOTS / len(square))[1, 1] * max(rest, 1 / weight.max() ** 2))
        factor = 4 / 3 / found[0] / top**2
        return float(factor * found[1]), float(factor * spread)

    def to_xarray(self) -> xr.Dataset:
        """Curves over `amplitude`, `displacement` and `velocity`, and the points."""
        over = {
            "amplitude": ("omega", "omega_std", "damping", "damping_std"),
            "displacement": ("restoring", "restoring_std"),
            "velocity": ("dissipative", "dissipative_std"),
        }
        data: dict[str, Any] = {name: ((axis,), getattr(self, name)) for axis, names in over.items() for name in names}
        data["point"] = (("row", "shows"), self.points)
        coords = {axis: getattr(self, axis) for axis in over} | {"shows": ["amplitude", "omega", "damping"]}
        coords["record"] = ("row", self.records)
        attributes = {"case": self.case, "axis": "xy"[self.axis], "scatter": self.scatter}
        return xr.Dataset(data, coords, attributes)

    def plot(self, ax: "Axes | None" = None) -> "Axes":
        """Frequency over amplitude with its band."""
        from matplotlib import pyplot as plt

        ax = plt.subplots()[1] if ax is None else ax
        hertz, std = self.omega / (2 * np.pi), self.omega_std / (2 * np.pi)
        ax.plot(self.points[:, 0], self.points[:, 1] / (2 * np.pi), ".", ms=3, color="0.6")
        ax.plot(self.amplitude, hertz)
        ax.fill_between(self.amplitude, hertz - 2 * std, hertz + 2 * std, alpha=0.3)
        ax.set_xlabel(f"amplitude [{self.length}]")
        ax.set_ylabel("frequency [Hz]")
        return ax

    def __str__(self) -> str:
        a, hertz = self.amplitude, self.omega / (2 * np.pi)
        what = f"amplitude [{self.length}], frequency [Hz], damping per mass [1/s]"
        lines = [f"{self.case}, axis {'xy'[self.axis]}: {what}"]
        for i in np.unique(np.linspace(0, len(a) - 1, 8).astype(int)):
            lines.append(
                f"  {a[i]:10.4g}   {hertz[i]:.6g} ± {self.omega_std[i] / (2 * np.pi):.2g}   "
                f"{self.damping[i]:.4g} ± {self.damping_std[i]:.2g}"
            )
        slope, std = self.hardening
        lines.append(
            f"  as a cubic spring over these amplitudes, k3/k1 = {slope:.4g} ± {std:.2g} 1/{bracketed(self.length)}²"
        )
        seen = f"below {a[0]:.3g} and above {a[-1]:.3g} {self.length}"
        lines.append(f"  {seen} nothing was seen: there the forces extrapolate")
        return "\n".join(lines)


def backbone(fit: CaseFit, axis: int = 0, *, knots: int = KNOTS) -> Backbone:
    """What the sweeps and decays of a case show of one axis, whatever the law.

    Args:
        fit: the case beside a model, from `fit`; the better it knows the instrument, the better.
        axis: 0 = x, 1 = y.
        knots: between which each force is a straight line over its own variable.

    Raises:
        InputError: where no sweep drives the axis and nothing rings down, too few rows do, or for what is no fit.
    """
    check_kind("fit", fit, CaseFit, "what `fit` returned")
    given = equations(fit, axis)
    a, speed = given.amplitude, given.amplitude * given.omega
    grids = [_knots(size, knots) for size in (a, speed)]
    hats = [_hats(grid) for grid in grids]
    at_rows = [
        np.stack([describing(hat, size) for hat in some], 1) for some, size in zip(hats, (a, speed), strict=True)
    ]
    columns = given.columns(*at_rows)
    weight = given.robust(columns)
    found, covariance, rest = given.solve(columns, weight)
    device, count = fit.model.device, knots
    base = float(device.stiffness[axis]), float(device.damping[axis])
    mass = 1.0 / abs(float(device.mobility))
    amplitude = np.geomspace(a.min(), a.max(), 60)
    typical = float(np.exp(np.mean(np.log(given.omega))))
    curves = []
    for part, some, scale in ((0, hats[0], 1.0), (1, hats[1], typical)):
        place = slice(part * count, part * count + count)
        table = np.stack([describing(hat, scale * amplitude) for hat in some], 1)
        own = np.linspace(0.0, scale * a.max(), 80)
        shape = np.stack([hat(own) * own for hat in some], 1)
        some_covariance = covariance[place, place]
        curves.append(
            (
                base[part] + table @ found[place], _std(table, some_covariance), own,
                mass * (base[part] * own + shape @ found[place]), mass * _std(shape, some_covariance),
            )
        )  # fmt: skip
    omega = np.sqrt(np.maximum(curves[0][0], 0.0))
    points = _points(given, found[2 * count :], at_rows, found[: 2 * count], rest, base)
    return Backbone(
        case=fit.case.name, axis=axis, amplitude=amplitude, omega=omega,
        omega_std=curves[0][1] / np.maximum(2 * omega, 1e-300), damping=curves[1][0], damping_std=curves[1][1],
        displacement=curves[0][2], restoring=curves[0][3], restoring_std=curves[0][4],
        velocity=curves[1][2], dissipative=curves[1][3], dissipative_std=curves[1][4],
        points=points, records=given.record, least=(float(a.min()), float(speed.min())),
        scatter=float(np.sqrt(np.average(rest**2, weights=weight))),
        length=length_of_records(fit.case), force=fit.case.words.force,
    )  # fmt: skip


def equations(fit: CaseFit, axis: int) -> Equations:
    """The rows of a case that show one axis; raises `InputError` where there are too few."""
    parts = [*_of_sweeps(fit, axis), *_of_decays(fit, axis)]
    count = sum(part.target.size for part in parts)
    if count < FEWEST:
        raise InputError(
            f"Argument `fit` must be of a case with sweeps or decays of axis {'xy'[axis]}, {FEWEST // 2} rows or more, "
            f"to draw a backbone, but has {count // 2}."
        )
    widest = max(part.others.shape[2] for part in parts)
    padded = [np.pad(part.others, ((0, 0), (0, 0), (0, widest - part.others.shape[2]))) for part in parts]
    names = [name for name in Equations.__dataclass_fields__ if name != "others"]
    joined = {name: np.concatenate([getattr(part, name) for part in parts]) for name in names}
    return Equations(others=np.concatenate(padded), **joined)


def _of_sweeps(fit: CaseFit, axis: int) -> list[Equations]:
    """A·w = −K·x·w − iωD·x·w + ε·m·u·w + b·Z·w: missing force per mass A; gain ε and constant reading b are unknown."""
    out, mobility = [], float(fit.model.device.mobility)
    for found in (one for one in sweep_forces(fit) if one.axis == axis):
        good = (np.abs(found.motion) > 0) & np.isfinite(found.force[:, axis]) & (found.std[:, axis] > 0)
        if not good.any():
            continue
        x, u, omega = found.motion[good], mobility * found.drive[good], found.frequency[good]
        missing = abs(mobility) * found.force[good, axis]
        operator = (missing + u) / x
        noise = abs(mobility) * found.std[good, axis] / np.maximum(np.abs(operator), 1e-300)  # of the displacement
        weight = 1.0 / (u * np.hypot(noise / np.abs(x), FLOOR))
        two = lambda values: np.stack([values.real, values.imag], axis=1)  # noqa: E731
        columns = [u + 0j, 1j * u, operator, 1j * operator]
        out.append(
            Equations(
                amplitude=np.abs(x), omega=omega, stiffness=two(-x * weight), damping=two(-1j * omega * x * weight),
                others=np.stack([two(column * weight) for column in columns], axis=2), target=two(missing * weight),
                record=np.repeat(found.record, len(x)), drive=found.drive[good],
            )
        )  # fmt: skip
    return out


def _of_decays(fit: CaseFit, axis: int) -> list[Equations]:
    """ω² = K(a) and 2γ = D(a) of every stretch of a record that rings down."""
    out, device = [], fit.model.device
    for record in fit.case.records:
        ringing = record.decay(fit.case, axis) if axis < fit.case.channels else None
        if ringing is None or (track := ringing.seen).time.size == 0:
            continue
        spread = np.stack([2 * track.omega * track.omega_std, 2 * track.decay_std], axis=1)
        shown = np.stack([track.omega**2, 2 * track.decay], axis=1)
        base = np.array([float(device.stiffness[axis]), float(device.damping[axis])])
        unit = np.eye(2)
        moved = np.abs(fit.case.readout.motion(track.phasor[:, None], track.omega)[:, 0])
        out.append(
            Equations(
                amplitude=moved, omega=track.omega,
                stiffness=unit[0] / spread, damping=unit[1] / spread, others=np.zeros((len(shown), 2, 0)),
                target=(shown - base) / spread, record=np.repeat(record.name, len(shown)), drive=np.zeros(len(shown)),
            )
        )  # fmt: skip
    return out


def _points(given: Equations, others, at_rows, found, rest: np.ndarray, base: tuple[float, float]) -> np.ndarray:
    """Amplitude, frequency and damping that each row shows by itself beside the nuisances."""
    count = at_rows[0].shape[1]
    smooth = np.stack([at_rows[0] @ found[:count], at_rows[1] @ found[count:]], axis=1)
    matrix = np.stack([given.stiffness, given.damping], axis=2)
    shown = smooth + np.linalg.solve(matrix, rest.reshape(-1, 2, 1))[..., 0] + np.array(base)
    return np.stack([given.amplitude, np.sqrt(np.maximum(shown[:, 0], 0.0)), shown[:, 1]], axis=1)


def _knots(size: np.ndarray, count: int) -> np.ndarray:
    """Zero, and values up to the largest, closer together where they are small."""
    top = float(size.max())
    return np.concatenate([[0.0], np.geomspace(max(float(size.min()), top / REACH), top, count - 1)])


def _hats(knots: np.ndarray) -> list[Callable[[np.ndarray], np.ndarray]]:
    """One for each knot: 1 there, 0 at the others, straight between them, constant beyond the last."""
    return [lambda size, k=k: np.interp(size, knots, np.eye(len(knots))[k]) for k in range(len(knots))]


def _std(table: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    return np.sqrt(np.maximum(np.einsum("ki,ij,kj->k", table, covariance, table), 0.0))
