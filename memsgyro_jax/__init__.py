"""memsgyro_jax: differentiable, batched simulation of vibratory gyroscopes and their comparison with measurements.

The names below are the table of contents, in the order of the two stories the package tells: a device in its closed
loop and the sweep over fabricated dies, then measurements and what they say about the model. They are imported on first
use, so that `memsgyro --help` answers without waiting for JAX. Modules used by name: `effects`, `losses`, `geometry`,
`electronics`, `runtime`, `cli`.
"""

import re as _re
from importlib import import_module as _import_module
from typing import TYPE_CHECKING


__version__ = "0.2.0"  # the one place: pyproject.toml takes it from here

if TYPE_CHECKING:
    # The one list of public names: read by people, editors and type checkers, and below for what is imported on use.
    # isort: off
    from .base.errors import InputError as InputError
    from .base.labelled import load as load
    from .device.gyro import SingleMassGyro as SingleMassGyro
    from .device.gyro import DualMassGyro as DualMassGyro
    from .device.gyro import AbstractGyro as AbstractGyro
    from .device.gyro import mode_frequencies as mode_frequencies
    from .loop.readout import ChargeAmplifier as ChargeAmplifier
    from .loop.readout import DirectReadout as DirectReadout
    from .loop.flicker import Flicker as Flicker
    from .loop.readout import Delayed as Delayed
    from .loop.carrier_readout import CarrierReadout as CarrierReadout
    from .loop.layout_readout import LayoutReadout as LayoutReadout
    from .loop.readout import Adc as Adc
    from .loop.readout import AbstractReadout as AbstractReadout
    from .loop.readout import AbstractLinearReadout as AbstractLinearReadout
    from .loop.readout import snr_density as snr_density
    from .loop.observers import ExtendedKalmanFilter as ExtendedKalmanFilter
    from .loop.observers import JumpTest as JumpTest
    from .loop.observers import LyapunovObserver as LyapunovObserver
    from .loop.observers import EnergyObserver as EnergyObserver
    from .loop.observers import RateSlopeFilter as RateSlopeFilter
    from .loop.observers import ScaleRatioFilter as ScaleRatioFilter
    from .loop.observers import KnownRateFilter as KnownRateFilter
    from .loop.blocks.block_filter import BlockFilter as BlockFilter
    from .loop.record_filter import filter_record as filter_record
    from .loop.observers import AbstractObserver as AbstractObserver
    from .loop.observers import AbstractCovarianceObserver as AbstractCovarianceObserver
    from .loop.observers import AbstractBlockObserver as AbstractBlockObserver
    from .loop.observers import NoObserver as NoObserver
    from .loop.observers import Estimate as Estimate
    from .loop.observers import Clock as Clock
    from .loop.observers import Prior as Prior
    from .loop.observers import ProcessNoise as ProcessNoise
    from .loop.observers import Annealing as Annealing
    from .loop.observers import design_prior as design_prior
    from .loop.observers import curves_of as curves_of
    from .loop.observers import FixedFading as FixedFading
    from .loop.observers import AdaptiveFading as AdaptiveFading
    from .loop.controllers import DampingCompensation as DampingCompensation
    from .loop.controllers import ReferenceModel as ReferenceModel
    from .loop.controllers import DesignedMotion as DesignedMotion
    from .loop.controllers import EnergyControl as EnergyControl
    from .loop.controllers import WholeAngle as WholeAngle
    from .loop.controllers import SlidingMode as SlidingMode
    from .loop.controllers import Saturated as Saturated
    from .loop.controllers import Ahead as Ahead
    from .loop.controllers import OpenLoop as OpenLoop
    from .loop.controllers import ClassicControl as ClassicControl
    from .loop.controllers import PhaseLockedDrive as PhaseLockedDrive
    from .loop.controllers import OpenSense as OpenSense
    from .loop.controllers import ForceRebalance as ForceRebalance
    from .loop.controllers import AbstractSense as AbstractSense
    from .loop.controllers import TrackingDemodulator as TrackingDemodulator
    from .loop.controllers import ProductDemodulator as ProductDemodulator
    from .loop.controllers import AbstractDemodulator as AbstractDemodulator
    from .loop.controllers import AbstractController as AbstractController
    from .loop.controllers import AbstractLinearController as AbstractLinearController
    from .loop.controllers import Tone as Tone
    from .device.propagate import Exact as Exact
    from .device.propagate import ForwardEuler as ForwardEuler
    from .loop.integrated import Integrated as Integrated
    from .loop.operation import Operation as Operation
    from .loop.filters import Lowpass as Lowpass
    from .loop.filters import Bandpass as Bandpass
    from .loop.scenario import Scenario as Scenario
    from .loop.scenario import AbstractProfile as AbstractProfile
    from .loop.scenario import Constant as Constant
    from .loop.scenario import Step as Step
    from .loop.scenario import Ramp as Ramp
    from .loop.scenario import Sine as Sine
    from .loop.scenario import Chirp as Chirp
    from .loop.scenario import Recorded as Recorded
    from .loop.scenario import RandomWalk as RandomWalk
    from .loop.loop import ClosedLoop as ClosedLoop
    from .loop.stability import loop_margins as loop_margins
    from .loop.stability import LoopMargins as LoopMargins
    from .loop.gain_phase import gain_phase_margins as gain_phase_margins
    from .loop.gain_phase import GainPhaseMargins as GainPhaseMargins
    from .loop.linearised import linearise as linearise
    from .loop.linearised import LinearisedLoop as LinearisedLoop
    from .loop.frequency_response import frequency_response as frequency_response
    from .loop.frequency_response import FrequencyResponse as FrequencyResponse
    from .loop.exported import export_loop as export_loop
    from .loop.exported import ExportedLoop as ExportedLoop
    from .loop.mode_matching import matching_bias as matching_bias
    from .loop.mode_matching import at_bias as at_bias
    from .loop.trace import simulate as simulate
    from .loop.trace_result import Trace as Trace
    from .loop.angle import vibration_angle as vibration_angle
    from .loop.angle import vibration_ellipse as vibration_ellipse
    from .loop.angle import VibrationEllipse as VibrationEllipse
    from .loop.angle import angle_by_lowpass as angle_by_lowpass
    from .loop.angle import angle_by_bandpass as angle_by_bandpass
    from .loop.angle import AngleRecord as AngleRecord
    from .loop.turned_angle import turned_angle as turned_angle
    from .loop.turned_angle import TurnedAngle as TurnedAngle
    from .loop.noise_budget import noise_budget as noise_budget
    from .loop.noise_budget import NoiseBudget as NoiseBudget
    from .loop.lyapunov_function import lyapunov_function as lyapunov_function
    from .loop.lyapunov_function import LyapunovFunction as LyapunovFunction
    from .loop.lyapunov_function import least_gain as least_gain
    from .loop.bound import information_bound as information_bound
    from .loop.bound import InformationBound as InformationBound
    from .loop.observers.scale_ratio import READOUT_SCALES as READOUT_SCALES
    from .loop.bound import CROSS_DAMPING_ASYMMETRY as CROSS_DAMPING_ASYMMETRY
    from .loop.observability import observability as observability
    from .loop.observability import observability_matrix as observability_matrix
    from .loop.observability import Observability as Observability
    from .montecarlo.spread import Spread as Spread
    from .montecarlo.spread import Vary as Vary
    from .montecarlo.spread import Normal as Normal
    from .montecarlo.spread import Uniform as Uniform
    from .motion import design_motion as design_motion
    from .motion import MotionDesign as MotionDesign
    from .motion import ModelErrors as ModelErrors
    from .motion import UncertainGyro as UncertainGyro
    from .montecarlo.sweep import sweep as sweep
    from .montecarlo.sweep import Lot as Lot
    from .montecarlo.parts import plan as plan
    from .montecarlo.parts import run_part as run_part
    from .montecarlo.parts import summarise as summarise
    from .montecarlo.parts import StoredSweep as StoredSweep
    from .montecarlo.parts import PartRun as PartRun
    from .montecarlo.summary import Summary as Summary
    from .montecarlo.sensitivity.sobol import sobol as sobol
    from .montecarlo.sensitivity import Sobol as Sobol
    from .montecarlo.sensitivity.tornado import tornado as tornado
    from .montecarlo.sensitivity import Tornado as Tornado
    from .montecarlo.sensitivity.corners import corners as corners
    from .montecarlo.sensitivity import Corners as Corners
    from .montecarlo.sensitivity import Output as Output
    from .montecarlo.sensitivity import mean_error as mean_error
    from .tuning.tunable import free as free
    from .tuning.tunable import Tunable as Tunable
    from .tuning.tune import tune as tune
    from .tuning.result import Tuning as Tuning
    from .tuning.replay import tune_on_record as tune_on_record
    from .tuning.replay import RecordTuning as RecordTuning
    from .app.study import load_study as load_study
    from .app.study import default_study as default_study
    from .app.study import Study as Study
    from .app.study import read_rate_record as read_rate_record
    from .couplings.record import read_sweep as read_sweep
    from .couplings.identify import identify as identify
    from .couplings.identify_ratio import identify_by_ratio as identify_by_ratio
    from .couplings.result import Identification as Identification
    from .couplings.modes import CoupledModes as CoupledModes
    from .couplings.modes import AxisAngles as AxisAngles
    from .couplings.modes import sense_errors as sense_errors
    from .couplings.modes import drive_errors as drive_errors
    from .couplings.frequency_sweep import FrequencySweep as FrequencySweep
    from .measurement.experiments import Experiment as Experiment
    from .couplings.bench import Bench as Bench
    from .measurement.experiments import PolarNoise as PolarNoise
    from .measurement.experiments import CartesianNoise as CartesianNoise
    from .base.transforms import Free as Free
    from .device.resonator import Resonator as Resonator
    from .measurement.model import Model as Model
    from .measurement.predicted_sweep import predict_sweep as predict_sweep
    from .measurement.predicted_sweep import PredictedSweep as PredictedSweep
    from .measurement.allan import allan as allan
    from .measurement.allan_result import Allan as Allan
    from .measurement.allan_variance import allan_deviation as allan_deviation
    from .measurement.scale_factor import scale_factor_test as scale_factor_test
    from .measurement.scale_factor_result import ScaleFactorTest as ScaleFactorTest
    from .measurement.scale_factor_result import MeasuredFigure as MeasuredFigure
    from .measurement.beside_lot import beside_lot as beside_lot
    from .measurement.beside_lot import BesideLot as BesideLot
    from .measurement.datasheet import datasheet as datasheet
    from .measurement.datasheet_rows import Datasheet as Datasheet
    from .measurement.datasheet_rows import DatasheetRow as DatasheetRow
    from .measurement.over_temperature import over_temperature as over_temperature
    from .measurement.over_temperature import OverTemperature as OverTemperature
    from .measurement.temperature_table import TemperatureTable as TemperatureTable
    from .measurement.case import load_case as load_case
    from .measurement.drive_levels import lowest_drives as lowest_drives
    from .measurement.import_case import import_case as import_case
    from .measurement.import_case import ImportedCase as ImportedCase
    from .measurement.user_kinds import load_kinds as load_kinds
    from .measurement.experiments import AbstractRecord as AbstractRecord
    from .measurement.case import write_case as write_case
    from .measurement.loop_record import case_of_trace as case_of_trace
    from .measurement.loop_record import append_to_case as append_to_case
    from .measurement.case import Case as Case
    from .measurement.case import DesignValue as DesignValue
    from .measurement.case import Environment as Environment
    from .measurement.case import FrequencySweepRecord as FrequencySweepRecord
    from .measurement.case import RingDownRecord as RingDownRecord
    from .measurement.case import FreeDecayRecord as FreeDecayRecord
    from .measurement.case import RateTableRecord as RateTableRecord
    from .measurement.case import OperatingPointsRecord as OperatingPointsRecord
    from .measurement.case import TimeRecord as TimeRecord
    from .measurement.case import assess as assess
    from .measurement.case import CaseQuality as CaseQuality
    from .effects import load_effects as load_effects
    from .diagnosis.compare import compare as compare
    from .diagnosis.compare import Comparison as Comparison
    from .diagnosis.fit import fit as fit
    from .diagnosis.fit import CaseFit as CaseFit
    from .measurement.model_file import write_model as write_model
    from .measurement.model_file import read_model as read_model
    from .diagnosis.backbone import backbone as backbone
    from .diagnosis.backbone import Backbone as Backbone
    from .diagnosis.law import draw_law as draw_law
    from .diagnosis.law_fit import fit_law as fit_law
    from .diagnosis.law import DrawnLaw as DrawnLaw
    from .diagnosis.diagnose import diagnose as diagnose
    from .diagnosis.result import Diagnosis as Diagnosis

    # Modules used by name: `mg.effects.CubicStiffness("x")`.
    from .app import cli as cli
    from .base import runtime as runtime
    from . import effects as effects
    from .device import electronics as electronics
    from .device import geometry as geometry
    from .tuning import losses as losses
    # isort: on

_FOLDERS = {
    "cli": "app.cli",
    "runtime": "base.runtime",
    "effects": "effects",
    "electronics": "device.electronics",
    "geometry": "device.geometry",
    "losses": "tuning.losses",
}
_SOURCE = __spec__.loader.get_source(__name__)  # type: ignore[union-attr]
_CONTENTS = {  # name: module that defines it
    name: module
    for module, name in _re.findall(r"^    from \.(\S+) import (\w+) as", _SOURCE, _re.MULTILINE)
    if name not in _FOLDERS
}

__all__ = [*_CONTENTS, *_FOLDERS, "__version__"]

if not TYPE_CHECKING:  # for a type checker, what is not in the list does not exist

    def __getattr__(name: str) -> object:
        if name in _CONTENTS:
            return getattr(_import_module(f"{__name__}.{_CONTENTS[name]}"), name)
        if name in _FOLDERS:
            return _import_module(f"{__name__}.{_FOLDERS[name]}")
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted([*__all__, *(name for name in globals() if name.startswith("__"))])
