"""memsgyro_jax: differentiable, batched simulation of vibratory gyroscopes and their comparison with measurements.

The names below are the table of contents, in the order of the two stories the package tells: a device in its closed
loop and the sweep over fabricated dies, then measurements and what they say about the model. They are imported on first
use, so that `memsgyro --help` answers without waiting for JAX.
"""

from importlib import import_module
from importlib.metadata import PackageNotFoundError, version


try:
    __version__ = version("memsgyro-jax")
except PackageNotFoundError:  # running from a source tree that was never installed
    __version__ = "0+unknown"

_CONTENTS = {
    # name: module that defines it
    "InputError": "base.errors",
    "SingleMassGyro": "device.gyro",
    "DualMassGyro": "device.gyro",
    "AbstractGyro": "device.gyro",
    "mode_frequencies": "device.gyro",
    "ChargeAmplifier": "loop.readout",
    "DirectReadout": "loop.readout",
    "Delayed": "loop.readout",
    "Adc": "loop.readout",
    "AbstractReadout": "loop.readout",
    "snr_density": "loop.readout",
    "ExtendedKalmanFilter": "loop.observers",
    "LyapunovObserver": "loop.observers",
    "AbstractObserver": "loop.observers",
    "Estimate": "loop.observers",
    "Clock": "loop.observers",
    "Prior": "loop.observers",
    "ProcessNoise": "loop.observers",
    "Annealing": "loop.observers",
    "design_prior": "loop.observers",
    "FixedFading": "loop.observers",
    "AdaptiveFading": "loop.observers",
    "DampingCompensation": "loop.controllers",
    "ReferenceModel": "loop.controllers",
    "DesignedMotion": "loop.controllers",
    "OpenLoop": "loop.controllers",
    "AbstractController": "loop.controllers",
    "Tone": "loop.controllers",
    "Exact": "device.propagate",
    "ForwardEuler": "device.propagate",
    "Lowpass": "loop.filters",
    "Bandpass": "loop.filters",
    "Scenario": "loop.scenario",
    "AbstractProfile": "loop.scenario",
    "Constant": "loop.scenario",
    "Step": "loop.scenario",
    "Ramp": "loop.scenario",
    "Sine": "loop.scenario",
    "Chirp": "loop.scenario",
    "Recorded": "loop.scenario",
    "RandomWalk": "loop.scenario",
    "ClosedLoop": "loop.loop",
    "simulate": "loop.trace",
    "Trace": "loop.trace",
    "information_bound": "loop.bound",
    "InformationBound": "loop.bound",
    "CROSS_DAMPING_ASYMMETRY": "loop.bound",
    "Spread": "montecarlo.spread",
    "Vary": "montecarlo.spread",
    "Normal": "montecarlo.spread",
    "Uniform": "montecarlo.spread",
    "design_motion": "motion",
    "MotionDesign": "motion",
    "ModelErrors": "motion",
    "UncertainGyro": "motion",
    "sweep": "montecarlo.sweep",
    "Lot": "montecarlo.sweep",
    "Summary": "montecarlo.summary",
    "sobol": "montecarlo.sensitivity",
    "Sobol": "montecarlo.sensitivity",
    "tornado": "montecarlo.sensitivity",
    "Tornado": "montecarlo.sensitivity",
    "corners": "montecarlo.sensitivity",
    "Corners": "montecarlo.sensitivity",
    "Output": "montecarlo.sensitivity",
    "free": "tuning.tunable",
    "Tunable": "tuning.tunable",
    "tune": "tuning.tune",
    "Tuning": "tuning.result",
    "tune_on_record": "tuning.replay",
    "RecordTuning": "tuning.replay",
    "load_study": "app.study",
    "default_study": "app.study",
    "Study": "app.study",
    "read_rate_record": "app.study",
    "read_sweep": "couplings.record",
    "identify": "couplings.identify",
    "identify_by_ratio": "couplings.identify_ratio",
    "Identification": "couplings.result",
    "CoupledModes": "couplings.modes",
    "AxisAngles": "couplings.modes",
    "sense_errors": "couplings.modes",
    "drive_errors": "couplings.modes",
    "FrequencySweep": "couplings.frequency_sweep",
    "Experiment": "measurement.experiments",
    "Bench": "couplings.bench",
    "PolarNoise": "measurement.experiments",
    "CartesianNoise": "measurement.experiments",
    "Free": "base.transforms",
    "Resonator": "device.resonator",
    "Model": "measurement.model",
    "load_case": "measurement.case",
    "write_case": "measurement.case",
    "Case": "measurement.case",
    "DesignValue": "measurement.case",
    "Environment": "measurement.case",
    "FrequencySweepRecord": "measurement.case",
    "RingDownRecord": "measurement.case",
    "RateTableRecord": "measurement.case",
    "TimeRecord": "measurement.case",
    "assess": "measurement.case",
    "CaseQuality": "measurement.case",
    "load_effects": "effects",
    "compare": "diagnosis.compare",
    "Comparison": "diagnosis.compare",
    "fit": "diagnosis.fit",
    "CaseFit": "diagnosis.fit",
    "write_model": "measurement.model_file",
    "read_model": "measurement.model_file",
    "diagnose": "diagnosis.diagnose",
    "Diagnosis": "diagnosis.result",
}
_FOLDERS = {
    "cli": "app.cli",
    "runtime": "base.runtime",
    "effects": "effects",
    "losses": "tuning.losses",
}  # used by name: `mg.effects.CubicStiffness("x")`

__all__ = [*_CONTENTS, *_FOLDERS, "__version__"]


def __getattr__(name: str) -> object:
    if name in _CONTENTS:
        return getattr(import_module(f"{__name__}.{_CONTENTS[name]}"), name)
    if name in _FOLDERS:
        return import_module(f"{__name__}.{_FOLDERS[name]}")
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted([*globals(), *_CONTENTS, *_FOLDERS])
