"""Which fabrication error matters? The same gyro twice: with a filter that knows nothing of its die, and with one that
relies on the design.

The first estimates every coefficient beside the rate and starts from the design values; the second takes stiffness and
damping for known and estimates rate and motion. A tornado moves one parameter at a time, Sobol indices say which share
of the variance each of them (and the noise) is answerable for, and the corners show the worst die. Where the response
is straight, the first-order index of a parameter is the square of its bar over the sum of all squares, which the table
checks.

At last the first gyro's design is centred: its two stiffnesses move, by gradient, to where fewest dies may be expected
to miss a tolerance, the dies moving along with them; the yield is then counted. The quick form has one gyro: these two
alone vary, and its filter estimates nothing else beside the rate; the read-out has no offsets.
"""

import time

import matplotlib.pyplot as plt
import numpy as np
from _common import Report
from scipy import stats

from memsgyro_jax.base import runtime


runtime.configure()

import memsgyro_jax as mg  # noqa: E402


RELIED_ON = ("kxx", "kyy", "kxy", "dxx", "dyy", "dxy", "sigma")
STIFFNESSES = ("kxx", "kyy")
TOLERANCE = np.radians(5.0)  # of the rate error at the end, which a centred design should keep
MOVED, VARIES = "rate error at the end", "rms rate error"  # what the tornado and the indices are drawn of


def main() -> None:
    report = Report()
    report.row("filters, parameters that vary", "2, all", "1, kxx and kyy" if report.quick else "2, all")
    points, repeats, sigmas = (32, 8, 1.0) if report.quick else (512, 64, 1.0)
    run = {"sample_rate": 50e3, "duration": 0.02} if report.quick else {"sample_rate": 100e3, "duration": 0.05}
    figure, axes = plt.subplots(2, 2, figsize=(13.0, 7.6), layout="constrained")
    for column, (name, (loop, share)) in enumerate(loops(report.quick).items()):
        spread, began = varying(share, report.quick), time.perf_counter()
        bars = mg.tornado(loop, spread, repeats=repeats, sigmas=sigmas, **run)
        shares = mg.sobol(loop, spread, points=points, **run)
        worst = mg.corners(loop, spread, repeats=2, sigmas=2.0, **run)
        print(f"\n== {name}, {100 * share:.2g} % spread\n{bars}\n\n{shares}\n\n{worst}")
        tell(report, name, bars, shares, worst)
        report.row(f"{name}: dies run", "-", shares.dies + len(worst.signs) * 2, f"{time.perf_counter() - began:.0f} s")
        bars.plot(axes[0, column], MOVED).set_title(f"{name}, spread {100 * share:.2g} %")
        shares.plot(axes[1, column], VARIES)
    for ax in axes[:, len(loops(report.quick)) :].flat:
        ax.set_axis_off()
    centred(report, run)
    report.picture(figure, "sensitivity")
    report.finish()


def centred(report: Report, run: dict) -> None:
    """The design stiffnesses that the yield wants, within a tenth of what they are."""
    loop, share = next(iter(loops(report.quick).values()))
    spread = varying(share, report.quick)
    bounds = {name: (0.9 * float(getattr(loop.device, name)), 1.1 * float(getattr(loop.device, name)))
              for name in STIFFNESSES}  # fmt: skip
    dies = 32 if report.quick else 256
    tuned = mg.tune(
        loop, free=mg.free(device=bounds), spread=spread, loss=mg.losses.ExpectedMisses(TOLERANCE), dies=dies,
        validation_dies=dies, report_dies=4 * dies, evaluations=4 if report.quick else 15, progress=print, **run,
    )  # fmt: skip
    print(tuned)
    for when, lot in zip(("before", "after"), tuned.lots, strict=True):
        good = int(np.sum(np.abs(lot.data["rate_error_end"].values) <= TOLERANCE))
        low, high = stats.binomtest(good, 4 * dies).proportion_ci()
        report.row(f"yield at {np.degrees(TOLERANCE):g} deg/s {when} centring", "-", good / (4 * dies),
                   f"{low:.2f} to {high:.2f}, {4 * dies} unseen dies")  # fmt: skip
    moved = ", ".join(f"{number.path} x {number.value / number.start:.3f}" for number in tuned.numbers)
    report.row("design moved", "-", moved)


def loops(quick: bool) -> dict[str, tuple[mg.ClosedLoop, float]]:
    """Each with the spread of the parameters that vary."""
    others = tuple(name for name in RELIED_ON if name not in STIFFNESSES)
    if quick:
        return {"estimates both stiffnesses": (watched(plain=True, known=others), 0.1)}
    return {"estimates everything": (watched(), 0.1), "relies on the design": (watched(known=RELIED_ON), 2e-5)}


def varying(share: float, quick: bool) -> mg.Spread:
    if not quick:
        return mg.Spread.relative(share)
    return mg.Spread(tuple(mg.Vary(f"device.{name}", mg.Normal(relative=share)) for name in STIFFNESSES))


def watched(plain: bool = False, **options) -> mg.ClosedLoop:
    """A `plain` read-out has no offsets."""
    gyro, readout = mg.SingleMassGyro.chi2010(), mg.ChargeAmplifier.chi2010()
    readout = mg.DirectReadout(1e5, noise_density=readout.noise_density) if plain else readout
    options = {"annealing": mg.Annealing(), "with_offsets": not plain, **options}
    observer = mg.ExtendedKalmanFilter.for_device(gyro, readout, **options)
    return mg.ClosedLoop(gyro, readout, observer, mg.DampingCompensation(tones=mg.Tone(600.0, 53.95)))


def tell(report: Report, name: str, bars: mg.Tornado, shares: mg.Sobol, worst: mg.Corners) -> None:
    k, end = shares.outputs.index(VARIES), shares.outputs.index(MOVED)
    first, most = bars.order(end)[0], int(np.argmax(shares.total[k]))
    size = max(abs(bars.low[end, first]), abs(bars.high[end, first]))
    report.row(f"{name}: {VARIES} at the design [deg/s]", "-", float(bars.design[k]))
    report.row(f"{name}: largest change of the {MOVED} [deg/s]", "-", float(size),
               f"{bars.inputs[first]}, ± {bars.std[end, first]:.2g}")  # fmt: skip
    low, high = shares.total_interval[k, most]
    report.row(f"{name}: largest total index", "-", float(shares.total[k, most]),
               f"{shares.inputs[most]}, {low:.2f} to {high:.2f}")  # fmt: skip
    noise = shares.inputs.index("noise")
    low, high = shares.total_interval[k, noise]
    report.row(f"{name}: share in which the noise takes part", "-", float(shares.total[k, noise]),
               f"{low:.2f} to {high:.2f}")  # fmt: skip
    straight = bars.slope[end] ** 2 / np.sum(bars.slope[end] ** 2)
    off = float(np.max(np.abs(shares.first[end, :-1] - straight)))
    report.row(f"{name}: first-order indices by the gradient alone, farthest off", 0.0, off, "0 if straight")
    corner = worst.order(k)[0]
    report.row(f"{name}: worst corner at 2 sigma [deg/s]", "-", float(worst.worst[k, corner]),
               f"{worst.lost[corner]:.0%} lost")  # fmt: skip


if __name__ == "__main__":
    main()
