"""Small measurement cases from the independent laboratory, and the package's models of the truth behind them.

All cases have one protocol and all models one structure, so that a session compiles each program once.
"""

from dataclasses import dataclass
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from lab.die import Die, Hidden
from lab.experiments import Record
from lab.laboratory import make_case
from lab.protocol import Laboratory, Profile, RateTable, Raw, RingDown, Sweep

import memsgyro_jax
from memsgyro_jax.device.normalised import NormalisedDevice
from memsgyro_jax.diagnosis.fit import CaseFit, fit_case
from memsgyro_jax.effects import CubicStiffness, Effect, Scanned, catalogue
from memsgyro_jax.measurement.case import Case, load_case
from memsgyro_jax.measurement.model import Model
from memsgyro_jax.measurement.readings import model_of


DIE = Die.drawn(np.random.default_rng(3))
EFFECTS = tuple(effect for effect in catalogue(2) if not isinstance(effect, Scanned))
# What acts on y is the same class again: without it the programs are half as large.
OF_X = tuple(effect for effect in EFFECTS if effect.where not in ("y", "y_to_x", "y_to_y"))
PROFILE = Profile((0.0, 90.0), 0.03, (90.0, 5.0, 20.0, 0.1), (-180.0, -160.0, 0.02))
NARROW = {"points": 5, "dense": np.inf, "both": False}
TINY = Laboratory(
    (
        Sweep("sweep_x", 0, (2e-8, 1.5e-7), points=7, span=10.0),
        Sweep("sweep_y", 1, (2e-8, 1.5e-7), points=7, span=10.0),
        Sweep("bias", 0, (5.0, 15.0), "bias", **NARROW, span=8.0),
        Sweep("soak", 0, (-40.0, 85.0), "temperature", **NARROW, span=12.0, shift=-2.0),
        RingDown("ringdown", 0, duration=0.02, interval=1e-4, samples=80, role="fit"),
        RateTable("rate", cycles=6, blocks=80, profile=PROFILE),
        Raw("raw", interval=1e-5, samples=300),
    ),
    digits=17,
)

# One axis, driven in volts: three levels of a sweep, and one in between that is not fitted.
RESONATOR = Die.resonator(68.6, 11.0, 0.98)
BAND = {"points": 15, "span": 25.0, "dense": 4.0, "both": False, "noise": 1e-4}
ONE_AXIS = Laboratory(
    (
        Sweep("sweep", 0, (0.002, 0.006, 0.012), **BAND),
        Sweep("sweep_check", 0, (0.009,), role="validation", **BAND),
    ),
    digits=17,
)


@dataclass(frozen=True, eq=False)
class Bench:
    """A case as the package reads it, and what only the laboratory knows."""

    case: Case
    die: Die
    hidden: Hidden
    records: dict[str, Record]

    def model(self, effects: tuple[Effect, ...] = EFFECTS) -> Model:
        """The truth in the package's words."""
        return truth(self.case, self.die, self.hidden, effects)


def bench(hidden: Hidden = Hidden(), seed: int = 0, protocol: Laboratory = TINY, die: Die = DIE) -> Bench:  # noqa: B008
    """The case of a die with hidden physics; made once per session."""
    return _made(hidden, seed, protocol, die)


@cache
def _made(hidden: Hidden, seed: int, protocol: Laboratory, die: Die) -> Bench:
    with TemporaryDirectory() as folder:
        made = make_case(Path(folder) / "case", die, hidden, seed, protocol)
        return Bench(load_case(made.folder), die, made.effects, made.records)


@cache
def demonstration() -> CaseFit:
    """The demonstration, fitted with the cubic spring that hides in it; made once per session."""
    return fit_case(load_case(Path(memsgyro_jax.__file__).parent / "demo"), [CubicStiffness(axis=0)])


def strengths(hidden: Hidden, effects: tuple[Effect, ...]) -> tuple[Effect, ...]:
    """The same effects at the laboratory's strengths, which go by the same names."""

    def one(effect: Effect) -> Effect:
        value = np.zeros(effect.strength.shape)
        told = np.atleast_1d(getattr(hidden, effect.label.replace(" ", "_")))
        value.flat[: told.size] = told
        return eqx.tree_at(lambda e: e.strength, effect, jnp.asarray(value))

    return tuple(map(one, effects))


def truth(case: Case, die: Die, hidden: Hidden, effects: tuple[Effect, ...] = EFFECTS) -> Model:
    """The package's model of a die of the laboratory."""
    size, m = (1 if die.axes == 1 else 3), die.mass
    device = NormalisedDevice(die.stiffness[:size] / m, die.damping[:size] / m, 1 / m)
    return model_of(case, device, offset=die.offset[: die.axes], effects=strengths(hidden, effects))
