"""A drawn law as a Python file with one effect per term, some ten lines each, to be edited."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from memsgyro_jax.measurement.calibration import per_second


LINEAR, HIGHEST = 0.1, 8.0  # an exponent nearer to zero is hardly told from the linear device; highest
DRY = -0.95  # lowest exponent of a damping: nearly a force that does not depend on the speed
ROUND = 0.3  # of a knot, over which a spline bends there: harmonic balance follows no corner
ROUNDING = 1e-6  # of the square of the unit size, below which a power is a straight line


# Exponents at which a term without a threshold is an effect of the catalogue, each with its name there.
KNOWN = {
    ("stiffness", 2.0): "cubic_stiffness",
    ("even_stiffness", 1.0): "quadratic_stiffness",
    ("damping", 1.0): "quadratic_damping",
    ("damping", DRY): "dry_friction",
}
ALIKE = 0.05  # between exponents that are worth a try as one


@dataclass(frozen=True)
class LawTerm:
    """F = −strength·z·(max(|z| − threshold, 0)/size)^exponent, without a threshold the power of |z| itself; an even
    force has |z| for the first z.

    Args:
        kind: "stiffness", z the displacement, or "damping", z the velocity; "even_stiffness".
        strength: [N/m] or [N s/m], with `size` the force over z there.
        exponent: 0 is linear.
        threshold: [m] or [m/s]; `None` for none.
        size: largest z seen [m] or [m/s].
        least: smallest z seen, below which no threshold shows.
    """

    kind: str
    strength: float
    exponent: float
    threshold: float | None
    size: float
    least: float

    @property
    def bounds(self) -> tuple[float, float]:
        """Of the exponent: it does not pass through zero, where the term is the linear device's."""
        if self.threshold is not None:
            return 0.0, HIGHEST
        return (LINEAR, HIGHEST) if self.exponent > 0 else (DRY, -LINEAR)

    def known_as(self, exponent: float) -> str:
        """The effect of the catalogue whose law this is at such an exponent; empty where none is near."""
        near = [name for (kind, e), name in KNOWN.items() if kind == self.kind and abs(e - exponent) <= ALIKE]
        return "".join(near) if self.threshold is None else ""

    def share(self, z: np.ndarray) -> np.ndarray:
        """Force over z at strength one."""
        over = (np.abs(z) if self.threshold is None else np.maximum(np.abs(z) - self.threshold, 0.0)) / self.size
        power = (over**2 + ROUNDING) ** (0.5 * self.exponent)
        if self.threshold is None:
            return np.asarray(power)
        return np.asarray(over * power * self.size / np.maximum(np.abs(z), 1e-300))

    @property
    def formula(self) -> str:
        """For people."""
        z = "v" if self.kind == "damping" else "q"
        if self.kind == "even_stiffness":
            return f"F = −s·|q|·|q/{self.size:.4g}|^exponent"
        if self.threshold is None:
            return f"F = −s·{z}·|{z}/{self.size:.4g}|^exponent"
        return f"F = −s·sign({z})·(|{z}| − threshold)^(1 + exponent) / {self.size:.4g}^exponent beyond the threshold"


def bends(knots: np.ndarray) -> list[Callable[[np.ndarray], np.ndarray]]:
    """One for each knot: a straight line that begins there with a rounded corner (the same line stands in the file)."""
    top = knots[-1]

    def bend(z: np.ndarray, knot: float) -> np.ndarray:
        over = (np.abs(z) - knot) / top
        return np.asarray(0.5 * (over + np.sqrt(over**2 + (ROUND * knot / top) ** 2)))

    return [lambda z, knot=knot: bend(z, knot) for knot in knots[:-1]]


def law_text(
    case: str,
    axis: int,
    names: Sequence[str],
    seen: tuple[tuple[float, float], tuple[float, float]],
    terms: Sequence[LawTerm],
    splines: Sequence[tuple[np.ndarray, np.ndarray]],
    length: str = "m",
    units: str = "",
) -> str:
    """The text of the file: the terms, or a spline per kind, each under its name.

    Args:
        case: where the law was drawn from.
        axis: of the effects.
        names: of the effects.
        seen: lowest and highest displacement and velocity amplitude that any row has.
        terms: of the law.
        splines: knots and values of each, where there are no terms.
        length: unit of a displacement.
        units: sentence on what m and N in the file stand for, where not for themselves.
    """
    (low, high), (slow, fast) = seen
    title = case.replace("\\", "/").replace('"', "'")
    head = (
        f'"""What the records of {title} show beyond a linear device. Edit it, then fit it:\n\n'
        "    memsgyro law CASE --edited THIS_FILE\n\n"
        f"Seen at amplitudes from {low:.4g} to {high:.4g} {length}\n"
        f"and {slow:.4g} to {fast:.4g} {per_second(length)}; elsewhere it extrapolates."
        + (f"\nHere {units}." if units else "")
        + '\n"""\n\n'
        "import equinox as eqx\nimport jax.numpy as jnp\nfrom jax import Array\n\nimport memsgyro_jax.effects as fx\n"
    )
    bodies = [_term_text(name, term, axis) for name, term in zip(names, terms, strict=False)]
    bodies += [_spline_text(name, *spline, axis) for name, spline in zip(names, splines, strict=False)]
    listed = "".join(f"{_title(name)}(), " for name in names).rstrip()
    return "\n\n".join([head, *bodies, f"EFFECTS = ({listed})\n"])


_HEAD = """class {title}(fx.ForceEffect):
    name, unit = "{name}", "{unit}"
    law = "{law}"
    axis: int = eqx.field(static=True, default={axis})
    strength: fx.Scalar = fx.strength({strength})
"""


def _head(name: str, law: str, axis: int, strength: object) -> str:
    title = _title(name)
    unit = "N/m" if "stiffness" in name else "N·s/m"
    return _HEAD.format(title=title, name=name, unit=unit, law=law, axis=axis, strength=strength)


def _title(name: str) -> str:
    return "".join(word.capitalize() for word in name.split("_"))


def _variable(name: str) -> str:
    return f"now.{'displacement' if 'stiffness' in name else 'velocity'}[self.axis]"


def _term_text(name: str, term: LawTerm, axis: int) -> str:
    low, high = term.bounds
    lines = [_head(name, term.formula, axis, f"{term.strength:.6g}" + (", sign=+1" if high < 0 else ""))]
    start = min(max(term.exponent, low + 0.01), high - 0.01)  # within, not at a bound
    lines.append(f"    exponent: fx.Scalar = fx.parameter(start={start:.4g}, low={low}, high={high})\n")
    size = f"{term.size:.6g}"
    over = f"jnp.abs(z) / {size}"
    if term.threshold is not None:
        unit = "m" if term.kind == "stiffness" else "m/s"
        lines.append(
            f"    threshold: fx.Scalar = fx.parameter(start={term.threshold:.6g}, low={0.5 * term.least:.4g}, "
            f'high={size}, unit="{unit}")\n'
        )
        over = f"jnp.maximum(jnp.abs(z) - self.threshold, 0.0) / {size}"
    factor = "z" if term.threshold is None else f"{size} * jnp.sign(z) * over"
    factor = "jnp.abs(z)" if term.kind == "even_stiffness" else factor
    lines.append(
        "\n    def force(self, now: fx.Moment) -> Array:\n"
        f"        z = {_variable(name)}\n"
        f"        over = {over}\n"
        f"        return self.along(now, -self.strength * {factor} * (over**2 + {ROUNDING}) ** (0.5 * self.exponent))\n"
    )
    return "".join(lines)


def _spline_text(name: str, knots: np.ndarray, values: np.ndarray, axis: int) -> str:
    listed = lambda numbers: "(" + ", ".join(f"{n:.6g}" for n in numbers) + ")"  # noqa: E731
    head = _head(name, "F = −s(|z|)·z, s bent at each knot", axis, listed(values))
    return (
        f"{head}\n    def force(self, now: fx.Moment) -> Array:\n"
        f"        z = {_variable(name)}\n"
        f"        knots = jnp.asarray({listed(knots[:-1])})\n"
        f"        over = (jnp.abs(z) - knots) / {knots[-1]:.6g}\n"
        f"        bends = 0.5 * (over + jnp.sqrt(over**2 + ({ROUND} * knots / {knots[-1]:.6g}) ** 2))\n"
        "        return self.along(now, -jnp.sum(self.strength * bends) * z)\n"
    )
