"""What the laboratory measures: experiments with their settings, noise and lengths (SI)."""

from dataclasses import dataclass

import numpy as np
from lab.faults import Faults


SOUND = Faults()


@dataclass(frozen=True)
class Sweep:
    """Settled lock-in sweeps, one per value of a condition: drive [N], bias [V], temperature [degC] or rate [rad/s]."""

    name: str
    axis: int
    values: tuple
    condition: str = "drive"
    force: float = 2e-8
    points: int = 61  # per resonance
    span: float = 21.75  # either side of the resonance [Hz]
    dense: float = 2.2  # half width [Hz] within which points crowd; infinite is even spacing
    shift: float = 0.0  # of the band [Hz]
    settled: bool = True  # what the experimenter declares
    both: bool = True  # around both resonances, or the driven axis's alone
    noise: float = 6.324555320336759e-05
    role: str = ""


@dataclass(frozen=True)
class RingDown:
    """Driven from rest for a whole number of cycles within `duration`, then left alone; stamps may jitter by so much of
    an interval, and then a tenth of the rows is lost from the middle on.
    """

    name: str
    axis: int
    force: float = 1.5e-7
    duration: float = 1.0
    interval: float = 5e-5
    samples: int = 8000
    noise: float = 2e-3
    role: str = ""
    jitter: float = 0.0


@dataclass(frozen=True)
class Profile:
    """Rate of the table [deg/s]: plateaus of equal length, a sine of rising frequency, a ramp that jumps to rest."""

    plateaus: tuple = (0.0, 30.0, 0.0, -30.0, 0.0, 90.0, -90.0, 180.0, -180.0, 0.0)
    length: float = 0.4
    chirp: tuple = (90.0, 1.0, 8.0, 1.45)  # amplitude, first and last frequency [Hz], seconds
    ramp: tuple = (-180.0, -160.0, 0.35)  # first, last, seconds

    def __call__(self, t):
        """Rate at times t [s]."""
        ends = self.length * len(self.plateaus) + np.cumsum([0.0, self.chirp[3], self.ramp[2]])
        flat = np.array(self.plateaus)[np.clip((t / self.length).astype(int), 0, len(self.plateaus) - 1)]
        amplitude, low, high, seconds = self.chirp
        a = t - ends[0]
        wave = amplitude * np.sin(2 * np.pi * (low * a + 0.5 * (high - low) * a**2 / max(seconds, 1e-9)))
        first, last, rise = self.ramp
        slope = first + (last - first) * (t - ends[1]) / max(rise, 1e-9)
        return np.select([t < ends[0], t < ends[1], t < ends[2]], [flat, wave, slope], 0.0)


@dataclass(frozen=True)
class RateTable:
    """Open loop on the table, or standing still when there is no profile."""

    name: str
    axis: int = 0
    force: float = 6e-8
    cycles: int = 3
    blocks: int = 6014
    profile: Profile | None = None
    calibrated: bool = False
    noise: float = 6.324555320336759e-4
    role: str = ""


@dataclass(frozen=True)
class Raw:
    """Random multitone forces held over each sample, from rest; tones alternate between the axes."""

    name: str
    interval: float = 5e-6
    samples: int = 10_000
    band: tuple = (2500.0, 3900.0)  # Hz
    force: float = 9.6e-7  # root mean square per axis
    noise: float = 6.32455532033676e-3
    role: str = ""


@dataclass(frozen=True)
class Multisine:
    """One axis, a band-limited input of random phases [V] sampled with the output; the start is unknown."""

    name: str
    interval: float = 16384 / 1e7
    samples: int = 4096
    band: tuple = (1.0, 200.0)
    level: float = 0.02  # root mean square
    noise: float = 2.3e-4
    role: str = ""


@dataclass(frozen=True)
class Laboratory:
    """A list of experiments. `noise` scales every noise level; `digits` are those of the files (17 is exact), `finder`
    the decimals of the resonance [Hz] that bands are laid around; `faults` is what is wrong with its instruments.
    """

    experiments: tuple
    noise: float = 1.0
    digits: int = 7
    temperature: float = 25.0
    bias: float = 10.0
    declare_noise: bool = True
    finder: int = 1
    faults: Faults = SOUND

    @classmethod
    def full(cls, **changes):
        """The kinds, levels and lengths of a complete characterisation."""
        still = {"cycles": 60, "blocks": 2003, "noise": 1.4142135623730954e-4}
        drives, soak = (2e-8, 6e-8, 1.5e-7), (-40.0, -20.0, 0.0, 25.0, 45.0, 65.0, 85.0)
        narrow = {"points": 41, "span": 15.0, "dense": np.inf, "both": False}
        return cls(
            (
                Sweep("sweep_x", 0, drives),
                Sweep("sweep_y", 1, drives),
                Sweep("sweep_bias", 0, (5.0, 10.0, 15.0), "bias", **narrow),
                Sweep("soak", 0, soak, "temperature", **narrow | {"points": 66, "span": 32.5, "shift": -12.5}),
                RingDown("ringdown_x", 0),
                RingDown("ringdown_y", 1),
                RateTable("rate", profile=Profile()),
                RateTable("static", **still),
                Raw("raw"),
                Raw("raw_check", role="validation"),
            ),
            **changes,
        )

    @classmethod
    def small(cls, **changes):
        """A few hundred rows of every kind, quick to simulate and to fit."""
        profile = Profile((0.0, 90.0, -90.0, 180.0, 0.0), 0.1, (90.0, 2.0, 8.0, 0.2), (-180.0, -160.0, 0.05))
        few = {"points": 11, "span": 12.0, "dense": np.inf, "both": False}
        return cls(
            (
                Sweep("sweep_x", 0, (2e-8, 1.5e-7), points=15),
                Sweep("sweep_y", 1, (2e-8, 1.5e-7), points=15),
                Sweep("sweep_bias", 0, (5.0, 15.0), "bias", **few),
                Sweep("soak", 0, (-40.0, 25.0, 85.0), "temperature", **few | {"span": 16.0, "shift": -4.0}),
                RingDown("ringdown_x", 0, duration=0.1, interval=1e-4, samples=400),
                RingDown("ringdown_y", 1, duration=0.1, interval=1e-4, samples=400),
                RateTable("rate", cycles=6, blocks=400, profile=profile),
                RateTable("static", cycles=20, blocks=60, noise=1.4142135623730954e-4),
                Raw("raw", interval=1e-5, samples=1000),
                Raw("raw_check", interval=1e-5, samples=1000, role="validation"),
            ),
            **changes,
        )

    @classmethod
    def demo(cls, **changes):
        """The kinds that tell a nonlinear spring, in files of some ten thousand numbers."""
        profile = Profile((0.0, 90.0, -90.0, 180.0, 0.0), 0.15, (90.0, 2.0, 8.0, 0.3), (-180.0, -160.0, 0.1))
        return cls(
            (
                Sweep("sweep_x", 0, (2e-8, 6e-8, 1.5e-7), points=25),
                Sweep("sweep_y", 1, (2e-8, 1.5e-7), points=25),
                RingDown("ringdown_x", 0, duration=0.5, interval=1e-4, samples=2000, role="validation"),
                RateTable("rate", cycles=6, blocks=600, profile=profile),
                Raw("raw", samples=1500),
                Raw("raw_check", samples=1500, role="validation"),
            ),
            **changes,
        )

    @classmethod
    def resonator(cls, **changes):
        """One axis: multisines of two lengths, a sweep at three drives [V], a ring-down."""
        sweep = {"points": 31, "span": 25.0, "dense": 4.0, "both": False, "noise": 1e-4}
        return cls(
            (
                Sweep("sweep", 0, (0.002, 0.006, 0.012), **sweep),
                RingDown("ringdown", 0, 0.012, 0.5, 16384 / 1e7, 400, 2.3e-4),
                Multisine("multisine"),
                Multisine("multisine_check", samples=1024, role="validation"),
            ),
            **changes,
        )
