"""Does a loop in blocks end where the loop of samples ends? With the same noise, and with noise drawn in blocks.

The same noise: the difference of the rate errors at the end in claimed deviations, for several commands and rates, both
devices and two spreads, on the devices of `any_device.py`, and how it falls with shorter blocks. Drawn noise: whether
the errors over their claims are standard normal (Kolmogorov and Smirnov), the NEES within its 99 % interval, and the
ratio to the bound of each die.
"""

import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
from _common import Report
from any_device import devices as devices_elsewhere
from any_device import study_of
from scipy import stats

import memsgyro_jax as mg
from memsgyro_jax.base import runtime
from memsgyro_jax.loop.blocks.length import Blocks


runtime.configure()
READOUT = mg.ChargeAmplifier.chi2010()
NEWTON = (6.8e-8, 1.04e-7)  # that hold 1 µm on the modes of the single mass against its damping
_LATE = 4096  # samples
TONE, RESONANT = mg.Tone(600.0, 53.95), (mg.Tone(2893.0, NEWTON[0]), mg.Tone(3758.8, NEWTON[1]))
CASES = {
    "damping compensation": (mg.DampingCompensation(tones=TONE), 1.0),
    "damping compensation, rate of 10 Hz": (mg.DampingCompensation(tones=TONE), mg.Sine(1.0, 10.0)),
    "damping compensation, no tone": (mg.DampingCompensation(), 1.0),
    "reference model": (mg.ReferenceModel((3000.0, 5000.0)), 1.0),
    "open loop, tones on both modes": (mg.OpenLoop(RESONANT), 1.0),
}


def lot(loop: mg.ClosedLoop, rate, dies: int, spread: float = 0.15) -> dict[str, np.ndarray]:
    return columns(mg.sweep(loop, mg.Spread.relative(spread), rate, dies=dies, bound_dies=0))


def columns(found: mg.Lot) -> dict[str, np.ndarray]:
    return {name: found.data[name].values for name in ("rate_error_end", "rate_std_end", "nees_end", "status")}


def apart(blocks: dict, samples: dict) -> tuple[float, str]:
    """Root mean square of the difference in percent of the claimed deviation, of the dies that the filter follows
    sample by sample, and how many those are not: where it diverges there is nothing that blocks could be equal to.
    """
    sound = samples["status"] == 0
    error = (blocks["rate_error_end"] - samples["rate_error_end"]) / samples["rate_std_end"]
    left_out, lost = np.sum(~sound), np.sum(sound & (blocks["status"] != 0))
    said = [f"{left_out} of {sound.size} dies left out, which diverge sample by sample"] * bool(left_out)
    said += [f"{lost} that samples follow diverge in blocks"] * bool(lost)
    return 100.0 * float(np.sqrt(np.mean(error[sound] ** 2))) if sound.any() else np.nan, "; ".join(said)


def made(gyro, controller) -> mg.ClosedLoop:
    observer = mg.ExtendedKalmanFilter.for_device(gyro, READOUT, annealing=mg.Annealing())
    return mg.ClosedLoop(gyro, READOUT, observer, controller)


def elsewhere(report: Report, dies: int) -> None:
    """Devices far from the thesis', each started, driven and sampled as a file with the device alone has it."""
    for number, device in enumerate(devices_elsewhere(24)):
        with tempfile.TemporaryDirectory() as folder:
            settings = study_of(device, Path(folder)).changed({"sweep.dies": dies}).sweep_arguments
        loop, settings = settings["loop"], {**settings, "bound_dies": 0}
        plain, found = (
            columns(mg.sweep(**{**settings, "loop": one}))
            for one in (loop, replace(loop, blocks=Blocks(512, projected=True)))
        )
        error, told = apart(found, plain)
        name = f"{device['frequency [Hz]']:.0f} Hz, {device['split [Hz]']:.0f} Hz apart, Q {device['Q']:.0f}"
        report.row(f"device {number} of others, {name}: same noise", "<= 1.5 %", f"{error:.2f} %", told)


def main() -> None:
    report = Report()
    devices = {"one mass": mg.SingleMassGyro.chi2010(), "two masses": mg.DualMassGyro.chi2010()}
    dies, cases, spreads = (
        (64, CASES, (0.15, 0.05)) if not report.quick else (8, dict([next(iter(CASES.items()))]), (0.15,))
    )
    for device, gyro in devices.items() if not report.quick else [("one mass", devices["one mass"])]:
        for name, (controller, rate) in cases.items():
            for spread in spreads:
                loop = made(gyro, controller)
                plain = lot(loop, rate, dies, spread)
                found = lot(replace(loop, blocks=Blocks(512, projected=True)), rate, dies, spread)
                what = f"{device}, {name}, spread {100 * spread:g} %: same noise"
                error, told = apart(found, plain)
                report.row(what, "<= 1 %", f"{error:.2f} %", told)
    if report.quick:
        return report.finish()
    elsewhere(report, dies)
    loop = made(devices["one mass"], CASES["damping compensation"][0])
    # A rate that could move has maps made for every block: shared ones leave 0.1 % at any length, and hide the order. A
    # start as short as by default leaves more of the filter's first, fast changes to the blocks: order 0.5 to 0.7.
    still, last = mg.Sine(0.0, 1.0), None
    plain = lot(loop, still, dies)
    for length in (1024, 512, 256, 128):
        error, _ = apart(lot(replace(loop, blocks=Blocks(length, _LATE, projected=True)), still, dies), plain)
        order = "" if last is None else f"order {np.log2(last / error):.1f}"
        report.row(f"same noise, blocks of {length} from sample {_LATE} on", "falls", f"{error:.3f} %", order)
        last = error
    drawn = mg.sweep(loop.in_blocks(), mg.Spread.relative(0.15), 1.0, dies=4096, bound_dies=128)
    error = drawn.data["rate_error_end"].values / drawn.data["rate_std_end"].values
    report.row("drawn noise, Kolmogorov-Smirnov p", "> 0.01", f"{stats.kstest(error, 'norm').pvalue:.2f}", "4096 dies")
    low, high = stats.chi2.ppf([0.005, 0.995], 14 * 4096) / 4096
    report.row("drawn noise, NEES", f"{low:.2f} - {high:.2f}", f"{drawn.data['nees_end'].values.mean():.2f}")
    print(drawn)
    return report.finish()


if __name__ == "__main__":
    main()
