"""What does temperature do to a gyro, and how much of it does a table take away?

A force-rebalanced gyro whose springs, damping, electronics and electrodes drift with the temperature, in a chamber held
at one temperature after another, then on two ramps of which the first gives the table and the second judges it; its
self-heating after power-on, and its zero-rate output over years.
"""

import matplotlib.pyplot as plt
import numpy as np
from _common import Report

import memsgyro_jax as mg
from memsgyro_jax.base import runtime


runtime.configure()
E = mg.effects

RATE, FULL, AMPLITUDE = 100e3, np.radians(200.0), 1e-6
MASS, OMEGA = 1e-8, 2.0 * np.pi * 5e3
COLD, ROOM, HOT = 233.15, 298.15, 358.15
STARTED = 0.15  # s after power-on
WARM = (
    E.ThermalStiffness(-6e-5), E.ThermalDamping(2e-3), E.ThermalGain(3e-4), E.ThermalDelay(5e-9), E.ThermalDrive(2e-4),
)  # fmt: skip
READOUT = mg.DirectReadout(1e5, noise_density=1e-9)


def made(*effects) -> mg.ClosedLoop:
    k, d, coupled = MASS * OMEGA**2, MASS * OMEGA, 2.0 * MASS * OMEGA * np.radians(30.0)  # a quadrature of 30 deg/s
    plain = mg.SingleMassGyro(MASS, k, k, coupled, d / 4000.0, d / 200.0, 1e-3 * d / 1000.0)
    control = mg.ClassicControl.force_rebalance(plain, READOUT, amplitude=AMPLITUDE, drive_bandwidth=400.0)
    gyro = plain.with_effect(*effects)
    return mg.ClosedLoop(gyro, READOUT, mg.NoObserver.for_device(gyro, READOUT), control, start=(0.0,) * 4)


def ramp(loop: mg.ClosedLoop, start: float, end: float, levels: list, duration: float, seed: int):
    """Temperature [K], output and rate [rad/s] along a run whose temperature goes from `start` to `end` while the table
    stands at one of `levels` after another, of each the second half.
    """
    dwell = duration / len(levels)
    edges = np.ravel([[STARTED + n * dwell, STARTED + (n + 1) * dwell - 1e-6] for n in range(len(levels))])
    scenario = mg.Scenario(
        rate=mg.Recorded(edges, np.repeat(levels, 2)),
        temperature=mg.Ramp(at=STARTED, slope=(end - start) / duration, start=start),
    )
    run = mg.simulate(loop, scenario, sample_rate=RATE, duration=STARTED + duration, seed=seed, decimation=100)
    since = run.time - STARTED
    rows = (since > 0.0) & (since / dwell % 1.0 > 0.5)
    return start + (end - start) * since[rows] / duration, run.rate_estimate[rows], run.rate_true[rows]


report = Report()
loop = made(*WARM)
figure, axes = plt.subplots(1, 3, figsize=(13, 4), layout="constrained")

places = np.linspace(COLD, HOT, 3 if report.quick else 9)
lot = mg.over_temperature(
    loop, mg.Spread.relative(0.002), temperatures=tuple(places), full_scale=FULL, dies=4 if report.quick else 32,
    sample_rate=RATE, duration=0.1 if report.quick else 0.3,
)  # fmt: skip
lot.plot(axes[0])
report.row(
    "zero-rate output over temperature, (max - min)/2", "-", float(np.degrees(np.mean(lot.zero_rate_drift))), "deg/s"
)
warmer = places - ROOM
by_hand = np.sqrt(1.0 - 6e-5 * warmer) / ((1.0 + 3e-4 * warmer) * (1.0 + 2e-4 * warmer))
report.row(
    "scale factor over temperature, (max - min)/2", f"{50.0 * np.ptp(by_hand):.4g} %",
    f"{100.0 * np.mean(lot.scale_factor_drift):.4g} %", "frequency over gain of the pick-off and of the electrodes",
)  # fmt: skip

duration = 1.0 if report.quick else 4.0
steps = 7 if report.quick else 11
levels = [0.0, FULL] * steps
first = ramp(loop, COLD, HOT, levels, duration, seed=1)
table = mg.TemperatureTable.fit(*first, knots=steps // 2)
temperature, output, rate = ramp(loop, HOT, COLD, [-0.5 * FULL, 0.0, 0.7 * FULL] * steps, duration, seed=2)
middle = mg.TemperatureTable(
    [COLD, HOT], *np.outer([np.interp(ROOM, table.temperatures, t) for t in (table.offset, table.scale)], [1, 1])
)
errors = {
    "trimmed at 25 °C": middle.corrected(output, temperature) - rate,
    "with the table": table.corrected(output, temperature) - rate,
}
for name, error in errors.items():
    axes[1].plot(temperature - 273.15, np.degrees(error), lw=0.5, label=name)
    report.row(f"second ramp, {name}: rms error", "-", float(np.degrees(np.std(error))), "deg/s")
axes[1].set(xlabel="temperature [°C]", ylabel="error of the rate [deg/s]")
axes[1].legend(frameon=False)

heating = E.SelfHeating(5e3, power=2e-3, settling=0.1 * duration)
still = mg.simulate(made(*WARM, heating), 0.0, sample_rate=RATE, duration=duration, decimation=100)
steady = mg.Scenario(temperature=mg.Constant(ROOM + 10.0))
warm = mg.simulate(loop, steady, sample_rate=RATE, duration=duration, decimation=100)
late = slice(-len(still.time) // 10, None)
report.row(
    "10 K of self-heating, zero-rate output at the end", f"{np.degrees(np.mean(warm.rate_estimate[late])):.4g}",
    float(np.degrees(np.mean(still.rate_estimate[late]))), "deg/s; claimed: a chamber 10 K warmer",
)  # fmt: skip
axes[2].plot(still.time, still.readings.frequency, label="heats itself")
axes[2].plot(warm.time, warm.readings.frequency, label="10 K warmer")
axes[2].set(xlabel="time after power-on [s]", ylabel="frequency of the swing [Hz]", ylim=(4997.0, 5001.0))
axes[2].legend(frameon=False)

day = 86400.0
ages = np.array([0.0, 10.0, 1000.0]) * day
outputs = []
for age in ages:
    ageing = E.AgeingOffset(np.radians(0.5), age=age), E.AgeingStiffness(-2e-5, age=age)
    run = mg.simulate(made(*ageing), 0.0, sample_rate=RATE, duration=0.2, decimation=100)
    outputs.append(np.degrees(np.mean(run.rate_estimate[-50:])))
for days, value in zip(ages[1:] / day, np.array(outputs[1:]) - outputs[0], strict=True):
    claimed = 0.5 * np.log10(1.0 + days)
    report.row(f"zero-rate output gained in {days:g} days", f"{claimed:.4g}", float(value), "deg/s; 0.5 per decade")
report.picture(figure, "temperature")
report.finish()
