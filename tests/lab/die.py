"""What an independent laboratory puts on its bench: the true die and the physics that hides in it (SI)."""

from dataclasses import dataclass, field, fields, replace

import numpy as np


@dataclass(frozen=True)
class Die:
    """True parameters of one device; the defaults are the design. `length` is its typical motion, for scaling alone."""

    mass: float = 1.8e-7
    kxx: float = 64.0
    kyy: float = 72.0
    kxy: float = 0.5
    dxx: float = 3.6e-6
    dyy: float = 4.5e-6
    dxy: float = 2.5e-7
    offset_x: float = 0.0
    offset_y: float = 0.0
    scale: float = 5e5
    length: float = 1e-6
    axes: int = 2

    @classmethod
    def drawn(cls, rng, spread=0.5):
        """A gyro inside the middle `spread` of the design's tolerances, with read-out offsets of some millivolts."""
        inside = {name: spread * rng.uniform(-t, t) for name, t in TOLERANCE.items()}
        design = cls()
        values = {name: getattr(design, name) * (1 + e) for name, e in inside.items()}
        offsets = {"offset_x": rng.uniform(0.01, 0.016), "offset_y": -rng.uniform(0.008, 0.011)}
        return replace(design, **values, **offsets)

    @classmethod
    def resonator(cls, resonance, quality, gain=1.0, offset=0.0, length=0.1):
        """One axis, x'' = -w0² x - (w0/Q) x' + g w0² u: displacement in the unit of the record, resonance in Hz."""
        w0 = 2 * np.pi * resonance
        mass = 1 / (gain * w0**2)
        k, d = mass * w0**2, mass * w0 / quality
        return cls(mass, k, k, 0.0, d, d, 0.0, offset, 0.0, scale=1.0, length=length, axes=1)

    @property
    def stiffness(self):
        return np.array([self.kxx, self.kyy, self.kxy])

    @property
    def damping(self):
        return np.array([self.dxx, self.dyy, self.dxy])

    @property
    def offset(self):
        return np.array([self.offset_x, self.offset_y])

    @property
    def period(self):
        """Of the faster axis [s]."""
        return 2 * np.pi * np.sqrt(self.mass / max(self.kxx, self.kyy))

    def resonances(self):
        """Undamped coupled resonances [Hz], ascending."""
        k = np.array([[self.kxx, self.kxy], [self.kxy, self.kyy]])
        return np.sqrt(np.linalg.eigvalsh(k / self.mass)) / (2 * np.pi)


# Relative half widths of the design interval; a cross term is drawn around the middle of its interval from zero.
TOLERANCE = {"mass": 0.1, "kxx": 0.1, "kyy": 0.1, "kxy": 1.0, "dxx": 0.2, "dyy": 0.2, "dxy": 1.0}


@dataclass(frozen=True)
class Outside:
    """Physics that no catalogue lists; every strength zero is absent. Stiffnesses in N/m, times in s, lengths in m."""

    # Bouc-Wen: F = -s h, h' = v - (|v| h + v |h|) / (2 yield): a spring that slips beyond a yield displacement.
    bouc_wen_x: float = 0.0
    bouc_wen_y: float = 0.0
    bouc_wen_yield: float = 2e-7
    # A stop of stiffness s behind a gap, on the positive side or on both.
    stop_x: float = 0.0
    stop_y: float = 0.0
    stop_gap: float = 1e-6
    stop_two_sided: bool = False
    # Maxwell element: F = -s r, r' = v - r / time: a spring in series with a dashpot (anelastic loss).
    maxwell_x: float = 0.0
    maxwell_y: float = 0.0
    maxwell_time: float = 1e-4
    # A second mode z of the same mass near a multiple of the resonance, with the energy s x^p z shared:
    # z'' = -w² z - (w/Q) z' - s x^p/m (internal resonance 1:p; Nayfeh and Mook, Nonlinear Oscillations, 1979).
    # `ratio` is w over the axis' own frequency.
    internal_x: float = 0.0
    internal_y: float = 0.0
    internal_order: int = 2
    internal_ratio: float = 2.0
    internal_quality: float = 1000.0
    # The drive amplifier warms up with what it delivers: u -> u (1 + s θ), θ' = ((u / 100 nN)² - θ) / time.
    drive_heating_x: float = 0.0
    drive_heating_y: float = 0.0
    drive_heating_time: float = 0.05
    drive_heating_force: float = 1e-7
    # The pick-off amplifier compresses with memory: V -> V (1 - s e), e' = ((q / 1 µm)² - e) / time.
    pickoff_compression_x: float = 0.0
    pickoff_compression_y: float = 0.0
    pickoff_compression_time: float = 0.02
    pickoff_compression_length: float = 1e-6


@dataclass(frozen=True)
class Hidden:
    """Strengths of the effects by catalogue name and variant (SI); zero is exactly absent."""

    cubic_stiffness_x: float = 0.0
    cubic_stiffness_y: float = 0.0
    quadratic_stiffness_x: float = 0.0
    quadratic_stiffness_y: float = 0.0
    cross_stiffness: float = 0.0
    electrostatic_softening_x: float = 0.0
    electrostatic_softening_y: float = 0.0
    electrostatic_cubic_stiffness_x: float = 0.0
    electrostatic_cubic_stiffness_y: float = 0.0
    bias_transduction_drive: float = 0.0
    bias_transduction_pickoff: float = 0.0
    cross_damping_asymmetry: float = 0.0
    quadratic_damping_x: float = 0.0
    quadratic_damping_y: float = 0.0
    squeeze_film_damping_x: float = 0.0
    squeeze_film_damping_y: float = 0.0
    dry_friction_x: float = 0.0
    dry_friction_y: float = 0.0
    thermal_drift_stiffness: float = 0.0
    thermal_drift_damping: float = 0.0
    thermal_curvature_stiffness: float = 0.0
    thermal_curvature_damping: float = 0.0
    thermal_drift_couplings: bool = False  # whether kxy and dxy drift as well
    rate_offset: float = 0.0
    rate_scale_error: float = 0.0
    angular_acceleration: float = 0.0
    centrifugal: float = 0.0
    # Coefficients a_1, a_2, ... of a_j cos(π j t / T) over one named record of length T [rad/s].
    rate_bias_drift: tuple = ()
    rate_bias_drift_record: str = "static"
    damping_step: float = 0.0
    damping_step_record: str = "static"
    damping_step_time: float = 0.0
    parasitic_mode_x: float = 0.0
    parasitic_mode_y: float = 0.0
    parasitic_mode_frequency: float = 2 * np.pi * 3050.0
    parasitic_mode_quality: float = 500.0
    force_misalignment_x_to_y: float = 0.0
    force_misalignment_y_to_x: float = 0.0
    drive_nonlinearity_x: float = 0.0
    drive_nonlinearity_y: float = 0.0
    electrical_feedthrough_x_to_x: float = 0.0
    electrical_feedthrough_x_to_y: float = 0.0
    electrical_feedthrough_y_to_x: float = 0.0
    electrical_feedthrough_y_to_y: float = 0.0
    readout_delay: float = 0.0
    pickoff_scale_error_x: float = 0.0
    pickoff_scale_error_y: float = 0.0
    pickoff_nonlinearity_x: float = 0.0
    pickoff_nonlinearity_y: float = 0.0
    pickoff_cubic_nonlinearity_x: float = 0.0
    pickoff_cubic_nonlinearity_y: float = 0.0
    pickoff_crosstalk_x_to_y: float = 0.0
    pickoff_crosstalk_y_to_x: float = 0.0
    adc_saturation: float = 0.0
    finite_sweep_rate: float = 0.0
    outside: Outside = field(default_factory=Outside)

    def pair(self, name):
        """Strengths of an effect that has a variant per axis."""
        return getattr(self, f"{name}_x"), getattr(self, f"{name}_y")

    def active(self):
        """Names of what is hidden, with its strength."""
        numbers = {f.name: getattr(self, f.name) for f in fields(self) if f.name != "outside"}
        settings = ("_record", "_time", "_frequency", "_quality", "_couplings")
        return {n: s for n, s in numbers.items() if s and not n.endswith(settings)}
