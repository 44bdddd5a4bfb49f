"""memsgyro_jax: differentiable, batched simulation of vibratory gyroscopes and their comparison with measurements.

The names below are the table of contents, in the order of the two stories the package tells: a device in its closed
loop and the sweep over fabricated dies, then measurements and what they say about the model. They are imported on first
use, so that `memsgyro --help` answers without waiting for JAX.
"""

import sys
from importlib import import_module
from importlib.metadata import PackageNotFoundError, version
from types import ModuleType


try:
    __version__ = version("memsgyro-jax")
except PackageNotFoundError:  # running from a source tree that was never installed
    __version__ = "0+unknown"

_CONTENTS = {
    # name: module that defines it
    "InputError": "errors",
    "SingleMassGyro": "device",
    "DualMassGyro": "device",
    "AbstractGyro": "device",
    "mode_frequencies": "device",
    "ChargeAmplifier": "readout",
    "DirectReadout": "readout",
    "Delayed": "readout",
    "Adc": "readout",
    "AbstractReadout": "readout",
    "snr_density": "readout",
    "ExtendedKalmanFilter": "observers",
    "LyapunovObserver": "observers",
    "AbstractObserver": "observers",
    "Estimate": "observers",
    "Clock": "observers",
    "Prior": "observers",
    "ProcessNoise": "observers",
    "Annealing": "observers",
    "design_prior": "observers",
    "FixedFading": "observers",
    "AdaptiveFading": "observers",
    "DampingCompensation": "controllers",
    "ReferenceModel": "controllers",
    "DesignedMotion": "controllers",
    "OpenLoop": "controllers",
    "AbstractController": "controllers",
    "Tone": "controllers",
    "Exact": "propagate",
    "ForwardEuler": "propagate",
    "Lowpass": "filters",
    "Bandpass": "filters",
    "Scenario": "scenario",
    "AbstractProfile": "scenario",
    "Constant": "scenario",
    "Step": "scenario",
    "Ramp": "scenario",
    "Sine": "scenario",
    "Chirp": "scenario",
    "Recorded": "scenario",
    "RandomWalk": "scenario",
    "ClosedLoop": "loop",
    "simulate": "trace",
    "Trace": "trace",
    "information_bound": "bound",
    "InformationBound": "bound",
    "CROSS_DAMPING_ASYMMETRY": "bound",
    "Spread": "spread",
    "Vary": "spread",
    "Normal": "spread",
    "Uniform": "spread",
    "design_motion": "motion",
    "MotionDesign": "motion",
    "ModelErrors": "motion",
    "UncertainGyro": "motion",
    "sweep": "sweep",
    "Lot": "sweep",
    "Summary": "summary",
    "sobol": "sensitivity",
    "Sobol": "sensitivity",
    "tornado": "sensitivity",
    "Tornado": "sensitivity",
    "corners": "sensitivity",
    "Corners": "sensitivity",
    "Output": "sensitivity",
    "free": "tunable",
    "Tunable": "tunable",
    "tune": "tune",
    "Tuning": "tuning",
    "tune_on_record": "replay",
    "RecordTuning": "replay",
    "load_study": "study",
    "default_study": "study",
    "Study": "study",
    "read_rate_record": "study",
    "read_sweep": "measurement",
    "identify": "identify",
    "identify_by_ratio": "identify_ratio",
    "Identification": "identification",
    "CoupledModes": "couplings",
    "AxisAngles": "couplings",
    "sense_errors": "couplings",
    "drive_errors": "couplings",
    "FrequencySweep": "experiments",
    "Experiment": "experiments",
    "Bench": "experiments",
    "PolarNoise": "experiments",
    "CartesianNoise": "experiments",
    "Free": "free",
    "Resonator": "resonator",
    "Model": "model",
    "load_case": "case",
    "write_case": "case",
    "Case": "case",
    "DesignValue": "case",
    "Environment": "case",
    "FrequencySweepRecord": "case",
    "RingDownRecord": "case",
    "RateTableRecord": "case",
    "TimeRecord": "case",
    "assess": "case",
    "CaseQuality": "case",
    "load_effects": "effects",
    "compare": "compare",
    "Comparison": "compare",
    "fit": "case_fit",
    "CaseFit": "case_fit",
    "write_model": "model_file",
    "read_model": "model_file",
    "diagnose": "diagnose",
    "Diagnosis": "diagnosis",
}
_FOLDERS = ("effects", "losses")  # used by name: `mg.effects.CubicStiffness("x")`

__all__ = [*_CONTENTS, *_FOLDERS, "__version__"]


def __getattr__(name: str) -> object:
    if name in _CONTENTS:
        return getattr(import_module(f"{__name__}.{_CONTENTS[name]}"), name)
    if name in _FOLDERS:
        return import_module(f"{__name__}.{name}")
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted([*globals(), *_CONTENTS, *_FOLDERS])


class _Contents(ModuleType):
    """A package in which `sweep` stays the function when the module of that name is imported."""

    def __setattr__(self, name: str, value: object) -> None:
        if not (name in _CONTENTS and isinstance(value, ModuleType)):
            super().__setattr__(name, value)


sys.modules[__name__].__class__ = _Contents
