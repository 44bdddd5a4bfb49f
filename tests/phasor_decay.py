"""A case of free decays of phasors, of one axis at 14 kHz, and an entry for each."""

CASE = """
schema = "memsgyro-case/1"
name = "decay"
device = "resonator"
[design]
resonance = { value = 14000, unit = "Hz", tolerance = 0.05 }
quality_factor = { low = 300, high = 20000, unit = "1" }
[readout]
quantity = "displacement"
"""
RECORD = """
[[experiment]]
name = "{name}"
kind = "free_decay"
file = "{name}.csv"
role = "fit"
reference_frequency = {{ value = 13990, unit = "Hz" }}
"""
