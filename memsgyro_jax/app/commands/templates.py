"""Files to begin with, commented; they run as they are."""

STUDY = """\
#:schema {schema}
# A study: run it with `memsgyro sweep {name}`, one die of it with `memsgyro simulate {name}`.
# Every section may be left out, and is then that of the gyro of the thesis; any unit of the right kind will do.
schema = "memsgyro-study/1"

[device]                                  # by its modes; or by kxx, kyy, kxy, dxx, dyy, dxy
kind = "single_mass"                      # or "dual_mass", with mass_x and mass_y; or "layout", by its dimensions
mass = "0.2 mg"
frequency = ["3.0 kHz", "3.6 kHz"]        # of the two modes, the lower one first
quality_factor = [900, 700]
quadrature = "50 deg/s"                   # how far the axes couple, as the rate that would look the same
temperature = "300 K"                     # brings the Brownian force; without it the noise is the electronics' alone

[readout]
kind = "displacement"                     # or "velocity", "capacitive", "charge_amplifier", "layout", "carrier"
scale = "0.5 V/um"                        # one value for both axes, or [x, y]
noise_density = "200 nV/sqrt(Hz)"

[observer]
kind = "ekf"                              # or "lyapunov", or "none" with a classic controller

[scenario]
rate = "100 deg/s"                        # or {{ kind = "sine", amplitude = "100 deg/s", frequency = "10 Hz" }}

[spread]
relative = "5 %"                          # standard deviation of each number of the device, from die to die;
                                          # of a coupling (kxy, dxy) of at least 1 % of the main ones

[sweep]                                   # sample_rate and duration follow the device where they are left out
dies = 64
tolerance = "20 deg/s"                    # a die yields when its rate error at the end is within it
seed = 0

# [[effects]]                             # physics beyond the linear device: `memsgyro effects` lists it
# name = "cubic_stiffness"
# axis = "x"
# strength = "1e9 N/m^3"
"""

DATASHEET = """\
#:schema {schema}
# A study for `memsgyro datasheet {name}`: a phase-locked drive and a rebalanced sense axis, as such gyros are built.
# `memsgyro tornado {name} --zero-rate` says which parameter matters, `memsgyro loop {name}` shows its loops.
schema = "memsgyro-study/1"

[device]
kind = "single_mass"
mass = "20 ug"
frequency = ["9 kHz", "9.3 kHz"]          # of the modes, drive first
quality_factor = [5_000, 400]
quadrature = "100 deg/s"
rotating_frame = true                     # keep what acceleration and other axes do: two lines of the datasheet
temperature = "300 K"                     # brings the Brownian force, without which the noise is the electronics' alone

[readout]
kind = "capacitive"
gradient = "5 nF/m"                       # dC/dx of each of the two halves: V/x = 2 * bias * gradient / feedback
capacitance = "250 fF"                    # of each half at rest
bias = "10 V"
feedback = "1 pF"
noise_density = "50 nV/sqrt(Hz)"          # at the output, one-sided

[controller]
kind = "classic"                          # phase-locked drive, amplitude control
sense = "rebalanced"                      # or "open"
amplitude = "1 um"

[spread]
relative = "0.5 %"                        # of each number of the device; of couplings of 1 % of the main ones at least
shared = 0.9                              # correlation among stiffnesses, among dampings: one etch makes both modes

[sweep]
dies = 32
sample_rate = "100 kHz"                   # ten samples in a period of the drive
duration = "0.4 s"                        # twice the start-up: figures count from half of it on, or from `settle`
tolerance = "5 deg/s"

# [[effects]]                             # what the datasheet is to count: drifts give the lines over temperature
# name = "thermal_drift"
# variant = "stiffness"
# strength = "-6e-5 1/K"
"""

TUNE = """\
#:schema {schema}
# A study for `memsgyro tune {name}`: a filter that follows a rate that walks, told wrong noises to begin with.
schema = "memsgyro-study/1"

[device]
kind = "single_mass"
mass = "180 ug"
frequency = ["3 kHz", "3.6 kHz"]
quality_factor = [900, 900]

[readout]
kind = "displacement"
scale = "0.1 V/um"
noise_density = "0.1 uV/sqrt(Hz)"

[observer]
kind = "ekf"
known = ["kxx", "kyy", "kxy", "dxx", "dyy", "dxy", "sigma"]  # without: a filter that finds them too
with_offsets = false
noise_density = "0.3 uV/sqrt(Hz)"         # three times too much
process_noise = {{ rate = "0.3 rad^2/s^3" }}  # a hundredth of the walk below

[controller]
kind = "open_loop"

[scenario]
rate = {{ kind = "random_walk", intensity = "30 rad^2/s^3", duration = "40 ms" }}

[spread.parameters]
"scenario.rate.realisation" = {{ kind = "uniform", low = "0", high = "1" }}  # each die its own walk

[sweep]
dies = 32
sample_rate = "100 kHz"
duration = "40 ms"
tolerance = "20 deg/s"

[tune]
free = ["observer.noise_density", "observer.process_noise.rate"]
dies = 16                                 # that are tuned on, and
validation_dies = 8                       # by which it is told when to stop
"""

LAYOUT = """\
#:schema {schema}
# A study by the drawing: `memsgyro sweep {name}`, `memsgyro tornado {name} --zero-rate`; the process varies, and moves
# both axes and the read-out together.
schema = "memsgyro-study/1"

[device]
kind = "layout"                           # a square plate on guided legs above a substrate
side = "1.2 mm"
thickness = "50 um"
length_x = "300 um"                       # of the legs that bend along x
length_y = "290 um"
width = "6 um"
gap = "3 um"
pressure = "5 kPa"

[readout]
kind = "layout"                           # the comb as drawn
fingers = 113
width = "50 um"
gap = "2 um"
overlap = "50 um"
bias = "10 V"
feedback = "1 pF"
noise_density = "0.45 uV/sqrt(Hz)"

[process]
sidewall = "0.2 deg"                      # of every die; what is left out is the drawing

[controller]
kind = "classic"

[spread.parameters]
"process.over_etch" = {{ kind = "normal", std = "30 nm" }}
"process.misalignment" = {{ kind = "normal", std = "0.02 deg" }}

[sweep]
dies = 32
duration = "50 ms"
"""

STUDIES = {"sweep": STUDY, "datasheet": DATASHEET, "tune": TUNE, "layout": LAYOUT}  # by what they are for

CASE = """\
#:schema {schema}
# A measurement case: `memsgyro check {name}`, then `memsgyro compare {name}` and `memsgyro diagnose {name}`.
# Put your own CSV files beside it; each header names its column with the unit, like "f [Hz],X [V],Y [V]".
schema = "memsgyro-case/1"
name = "{name}"
device = "resonator"                      # or "single_mass", with two axes
description = "a resonance, to be replaced by your own"

[design]                                  # what you know; what is left out is found from the records
resonance = {{ value = 3.0, unit = "kHz", tolerance = 0.02 }}
quality_factor = {{ value = 900, unit = "1", tolerance = 0.3 }}

[readout]
quantity = "displacement"                 # or "velocity", "acceleration": what the volts are proportional to
# scale = {{ value = 0.31, unit = "V/um", tolerance = 0.03 }}  # lets strengths be in SI; the tolerance goes with them

# [drive]
# unit = "V"
# scale = {{ value = 1.6, unit = "nN/V", tolerance = 0.05 }}   # force per unit of the drive, where it is known

[[experiment]]
name = "low"
kind = "frequency_sweep"                  # or "ring_down", "free_decay", "rate_table", "time_record"
file = "low.csv"
settled = true                            # every row was read after the transient had died away
# noise_std = {{ value = 50, unit = "uV" }}  # of I and Q; estimated from the rows where it is left out
# temperature_std = {{ value = 0.1, unit = "K" }}  # by how much the oven may be off; exact where it is left out

[[experiment]]
name = "high"                             # a second drive level separates springs that stiffen from those that do not
kind = "frequency_sweep"
file = "high.csv"
settled = true

[[experiment]]
name = "check"
kind = "frequency_sweep"
file = "check.csv"
settled = true
role = "validation"                       # never fitted: it judges
"""

EFFECT = '''\
"""My effect: `memsgyro effects {name}` checks and lists it, `memsgyro diagnose CASE --effects {name}` tries it."""

import equinox as eqx
import jax.numpy as jnp
from jax import Array

import memsgyro_jax.effects as fx


class SoftStop(fx.ForceEffect):
    # Name, unit of the strength, and the law as it is printed; strength zero must mean absent.
    name, unit, law = "soft_stop", "N/m²", "F = −s·(|q| − g)²·sign(q) beyond a gap g of 1.6 µm"
    reference = ""  # where the law is from
    axis: int = eqx.field(static=True, default=0)  # 0 is x, 1 is y
    strength: fx.Scalar = fx.strength()  # fx.strength(sign=+1) where physics gives the sign

    def force(self, now: fx.Moment) -> Array:
        """The force on the mass; `now` has displacement and velocity [m, m/s] of both axes, rate, temperature, time."""
        q = now.displacement[self.axis]
        return self.along(now, -self.strength * jnp.maximum(jnp.abs(q) - 1.6e-6, 0.0) ** 2 * jnp.sign(q))
'''
