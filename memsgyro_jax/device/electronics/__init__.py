"""Electronics that read a capacitance: a charge amplifier, and its carrier's synchronous detection."""

from .carrier import CarrierDetection as CarrierDetection
from .carrier_run import CarrierRun as CarrierRun
from .carrier_run import run_carrier as run_carrier
from .charge_stage import ChargeStage as ChargeStage
