"""A small measurement case of two uncoupled modes, written from closed formulas."""

import numpy as np


MASS, KX, KY, DX, DY, SCALE = 1.8e-7, 64.0, 72.0, 3.6e-5, 4.5e-5, 0.5e6  # damped well, so that records are short
NOISE = 1e-5

TOML = """\
schema = "memsgyro-case/1"
name = "bench"
device = "single_mass"

[design]
mass = { value = 1.8e-7, unit = "kg", tolerance = 0.10 }
kxx = { value = 64.0, unit = "N/m", tolerance = 0.10 }
kyy = { value = 72.0, unit = "N/m", tolerance = 0.10 }
kxy = { low = 0.0, high = 1.0, unit = "N/m" }
dxx = { value = 3.6e-5, unit = "N*s/m", tolerance = 0.20 }
dyy = { value = 4.5e-5, unit = "N*s/m", tolerance = 0.20 }
dxy = { low = 0.0, high = 5e-7, unit = "N*s/m" }

[readout]
scale = { value = 0.5, unit = "V/um" }
adc_range = { value = 0.1, unit = "V" }

[environment]
temperature = { value = 25.0, unit = "degC" }
bias_voltage = { value = 10.0, unit = "V" }

[[experiment]]
name = "sweep_x"
kind = "frequency_sweep"
file = "sweep_x.csv"
drive_axis = "x"
settled = true
noise_std = { value = 1e-5, unit = "V" }

[[experiment]]
name = "ringdown"
kind = "ring_down"
file = "ringdown.csv"
drive_axis = "y"
drive_force = { value = 50.0, unit = "nN" }
drive_frequency = { value = 3000.0, unit = "Hz" }
drive_duration = { value = 0.1, unit = "s" }
noise_std = { value = 1e-5, unit = "V" }

[[experiment]]
name = "rate"
kind = "rate_table"
file = "rate.csv"
drive_axis = "x"
drive_force = { value = 60.0, unit = "nN" }
drive_frequency = { value = 3000.0, unit = "Hz" }
lock_in_cycles = 3
noise_std = { value = 1e-5, unit = "V" }

[[experiment]]
name = "raw"
kind = "time_record"
file = "raw.csv"
hold = "zero_order"
start = "rest"
role = "validation"
"""


def _response(frequency, stiffness, damping):
    w = 2 * np.pi * frequency
    return SCALE / (stiffness - MASS * w**2 + 1j * w * damping)


def _write(path, header, *columns):
    np.savetxt(path, np.column_stack(columns), delimiter=",", header=header, comments="", fmt="%.9g")


def write_bench(folder, seed=0):
    """Writes the case into `folder` and returns the folder."""
    folder.mkdir(parents=True)
    rng = np.random.default_rng(seed)

    def noisy(values):
        return values + rng.normal(0, NOISE, np.shape(values))

    (folder / "case.toml").write_text(TOML)
    iq = "Vx_I [V],Vx_Q [V],Vy_I [V],Vy_Q [V]"
    f, level = np.tile(np.linspace(2900, 3100, 41), 2), np.repeat([20.0, 60.0], 41)
    x = level * 1e-9 * _response(f, KX, DX)
    parts = map(noisy, (x.real, x.imag, 0.01 * x.real, 0.01 * x.imag))
    _write(folder / "sweep_x.csv", f"F_x [nN],f [Hz],{iq}", level, f, *parts)
    t = np.arange(400) * 5e-5
    decay = 0.02 * np.exp(-DY / (2 * MASS) * t) * np.cos(np.sqrt(KY / MASS) * t)
    _write(folder / "ringdown.csv", "t [s],Vx [V],Vy [V]", t, noisy(0 * t), noisy(decay))
    t = (np.arange(120) + 0.5) * 3 / 3000
    rate = np.where((t > 0.04) & (t < 0.08), 100.0, 0.0)
    x = 60e-9 * _response(3000.0, KX, DX)
    still = np.ones_like(t)
    parts = map(noisy, (x.real * still, x.imag * still, 1e-5 * rate, 2e-5 * rate))
    _write(folder / "rate.csv", f"t [s],rate [deg/s],{iq}", t, rate, *parts)
    t = np.arange(300) * 2e-5
    force = 5 * np.cos(2 * np.pi * 300 * t)
    _write(
        folder / "raw.csv", "t [s],u_x [nN],u_y [nN],Vx [V],Vy [V]", t, 0 * t, force, noisy(0 * t), noisy(2e-5 * force)
    )
    return folder
