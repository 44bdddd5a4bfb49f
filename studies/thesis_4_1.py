"""Which motion tells the coefficients? Thesis 4.1.1 and 4.1.2, Figs 4.1 to 4.3 and 5.32, claims T7, T8 and part of T20.

Ranks and singular values of the observability matrix of motions given as formulas, in non-dimensional time (without
it a rank depends on the units), then of whole closed loops as they are sampled, and what an unequal cross damping does
to the rate.
"""

import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
from _common import PARTLY, Report, dps

import memsgyro_jax as mg
from memsgyro_jax.base import runtime
from memsgyro_jax.device.gyro import DUAL_MASS, SINGLE_MASS


runtime.configure()

PLACE = "thesis 4.1.1, 4.1.2"
ANSWERS = ("T7", "T8", "T20")
FIGURES = {"4.1": "fig_4_1_to_4_3", "4.2": "fig_4_1_to_4_3", "4.3": "fig_4_1_to_4_3", "5.32": "fig_5_32"}
SIZE = 1e-6  # m
GYRO = mg.SingleMassGyro.chi2010()
STIFF = float(GYRO.mass) * (2.0 * np.pi * 3000.0) ** 2  # N/m, unit of a feedback gain


def wave(frequency, phase=0.0):
    """sin(2π·frequency·t + phase)."""
    return lambda time: jnp.sin(2.0 * jnp.pi * frequency * time + phase)


def cosine(frequency):
    return wave(frequency, 0.5 * np.pi)


def motion(x, y):
    return lambda time: (SIZE * x(time), SIZE * y(time))


def added(*waves):
    return lambda time: sum(w(time) for w in waves)


def fed_back(moved, gains, tone=0.0):
    """u = gains · (x, y), and a 500 Hz tone on both axes."""

    def at(time):
        q = moved(time)
        extra = tone * SIZE * wave(500.0)(time)
        return tuple(STIFF * (row[0] * q[0] + row[1] * q[1] + extra) for row in gains)

    return at


NONE = lambda time: (0.0 * time, 0.0 * time)  # noqa: E731
ONE = motion(wave(3000.0), wave(3000.0))
BOTH = motion(added(wave(3000.0), cosine(5000.0)), added(cosine(3000.0), cosine(5000.0)))
APART = motion(wave(3000.0), wave(5000.0))
SAME = ((0.3, 0.7), (0.3, 0.7))  # as printed: u_x = u_y, not symmetric
SYMMETRIC = ((0.3, 0.5), (0.5, 0.7))
TIME = np.linspace(0.03e-3, 0.97e-3, 8)  # at 0 and 1 ms all sines vanish
CASES = (  # figure, model, motion, force, further arguments, printed rank, remark
    ("4.1(a)", SINGLE_MASS, ONE, NONE, {"known": ("sigma",)}, 4, "one frequency"),
    ("4.1(b)", SINGLE_MASS, BOTH, NONE, {"known": ("sigma",)}, 7, "two frequencies"),
    ("4.1(c)", SINGLE_MASS, BOTH, NONE, {"known": ("sigma",), "also": (mg.CROSS_DAMPING_ASYMMETRY,)}, "< 8",
     "dxy ≠ dyx"),
    ("4.2(a)", SINGLE_MASS, ONE, fed_back(ONE, SAME), {}, 4, "one frequency"),
    ("4.2(b)", SINGLE_MASS, APART, fed_back(APART, SAME), {}, 7, "u_x = u_y is not symmetric: the mass is told"),
    ("4.2(b), symmetric", SINGLE_MASS, APART, fed_back(APART, SYMMETRIC), {}, 7, "a change of the springs"),
    ("4.2(c)", SINGLE_MASS, APART, fed_back(APART, SAME, 1.0), {}, 8, "with a tone"),
    ("4.3(a)", DUAL_MASS, ONE, fed_back(ONE, SAME), {}, 4, "one frequency"),
    ("4.3(b)", DUAL_MASS, APART, fed_back(APART, SAME), {}, 8, "state feedback alone"),
    ("4.3(c)", DUAL_MASS, APART, fed_back(APART, SAME, 1.0), {}, 10, "with a tone"),
)  # fmt: skip


def figures(report: Report) -> None:
    time = TIME if report.quick else np.linspace(TIME[0], TIME[-1], 200)
    figure, axes = plt.subplots(2, 5, figsize=(16, 6), layout="constrained", sharey=True)
    for ax, (name, model, moved, force, more, claimed, remark) in zip(axes.flat, CASES, strict=True):
        found = mg.observability_matrix(model, moved, force, time, frequency=4000.0, velocity=True, **more)
        rank = found.rank
        text = f"{rank.min()}" if rank.min() == rank.max() else f"{rank.min()} to {rank.max()}"
        null = "; ".join(" ".join(f"{n} {v:+.3g}" for n, v in direction.items()) for direction in found.null)
        report.row(
            f"Fig {name}: rank of {len(found.names)}", claimed, text, remark + (f"; null: {null}" if null else "")
        )
        found.plot(ax)
        ax.set(title=f"Fig {name}: rank {text} of {len(found.names)}", ylim=(1e-18, 1e2))
        ax.get_legend().remove()
        ax.label_outer()
    figure.suptitle("dotted: what counts as zero", fontsize=10)
    report.picture(figure, "fig_4_1_to_4_3")
    still = lambda time: tuple(u + STIFF * SIZE for u in fed_back(APART, SYMMETRIC)(time))  # noqa: E731
    for velocity, claimed in ((False, 8), (True, 7)):
        found = mg.observability_matrix(SINGLE_MASS, APART, still, time, frequency=4000.0, velocity=velocity)
        what = "velocity" if velocity else "displacement"
        report.row(f"constant force, {what} read-out: rank of 8", claimed, int(found.rank.max()), "symmetric feedback")


def controls(report: Report) -> None:
    """Fig 5.32 in the loop as it is sampled: windows of four periods, everything unknown."""
    readout = mg.ChargeAmplifier.chi2010()
    observer = mg.ExtendedKalmanFilter.for_device(GYRO, readout)
    angular = 2.0 * np.pi * 3000.0
    tone = mg.Tone(600.0, 53.95)
    loops = (
        ("damping compensation", mg.DampingCompensation(tones=tone), "< 1e2"),
        ("reference model 3 / 3.674 kHz", mg.ReferenceModel(frequency=(3000.0, 3674.0), tones=tone), "about 1e3"),
        ("reference model 3 / 3 kHz", mg.ReferenceModel(frequency=(3000.0, 3000.0), tones=tone), "> 1e15"),
    )
    duration = 0.01 if report.quick else 0.1
    figure, axes = plt.subplots(1, 3, figsize=(13, 4), layout="constrained", sharey=True)
    for ax, (name, controller, claimed) in zip(axes, loops, strict=True):
        start = (SIZE, 0.7 * SIZE, 0.0, -SIZE * angular)
        loop = mg.ClosedLoop(GYRO, readout, observer, controller, start=start)
        found = mg.observability(loop, duration=duration)
        report.row(f"Fig 5.32, {name}: condition number, median", claimed, float(np.median(found.condition)),
                   f"{found.condition.min():.3g} to {found.condition.max():.3g}; told least: "
                   + ", ".join(f"{n} {v:+.3g}" for n, v in found.weakest.items()))  # fmt: skip
        found.plot(ax)
        ax.set_title(name)
        ax.label_outer()
    report.picture(figure, "fig_5_32")
    circle = motion(wave(3000.0), cosine(3000.0))
    found = mg.observability_matrix(SINGLE_MASS, circle, fed_back(circle, SYMMETRIC), TIME, frequency=4000.0)
    report.row("Fig 5.32, 3 / 3 kHz, motion without the tone: rank of 8", "< 8", int(found.rank.max()),
               "one frequency; the tone's own motion is what the sampled loop above still sees")  # fmt: skip


def unequal_damping(report: Report) -> None:
    """Thesis 4.1.2: what a rate estimate makes of dyx ≠ dxy, and the design rule."""
    mass = float(GYRO.mass)
    bias = lambda dxy, dyx: dps((dyx - dxy) / (4.0 * mass))  # noqa: E731
    report.row("bias of dxy, dyx = 3.6e-9, 3.96e-9 N·s/m [deg/s]", 0.029, float(bias(3.6e-9, 3.96e-9)),
               "10 % mismatch: (dyx - dxy)/(4 m), derived, not simulated")  # fmt: skip
    limit = 4.0 * mass * np.deg2rad(0.1) / 0.1
    report.row(
        "dxy for 0.1 deg/s at 10 % mismatch [N·s/m]", "3.96e-9", float(limit), "the printed rule does not follow"
    )


report = Report()
figures(report)
controls(report)
unequal_damping(report)

ranks = {name: report.found(f"Fig {name}: rank of {7 if name in ('4.1(a)', '4.1(b)') else 10 if name[2] == '3' else 8}")
         for name, *_ in CASES}  # fmt: skip
report.answer(
    "T7",
    claimed="ranks 4, 7 of 7, deficient (Fig 4.1); 4, 7, 8 of 8 (Fig 4.2); 4, 8, 10 of 10 (Fig 4.3)",
    obtained=", ".join(f"{name} {rank}" for name, rank in ranks.items()),
    reading=f"Fig 4.2(b) has {ranks['4.2(b), symmetric']} where the feedback is symmetric, a change of the springs; "
    "the printed u_x = u_y is not",
    verdict=PARTLY,
    why="All ranks but Fig 4.2(b) are right: feedback that is not symmetric makes the mass observable without a tone.",
)
report.answer(
    "T8",
    claimed="dxy < 3.96e-9 N·s/m keeps the rate within ±0.029 deg/s, and 0.1 deg/s follows from it",
    obtained=f"{report.found('bias of dxy, dyx = 3.6e-9, 3.96e-9 N·s/m [deg/s]'):.4f} deg/s at 3.6e-9, 3.96e-9 N·s/m",
    reading=f"0.1 deg/s at 10 % mismatch allows {report.found('dxy for 0.1 deg/s at 10 % mismatch [N·s/m]'):.3g} N·s/m",
    verdict=PARTLY,
    why="The bias (dyx - dxy)/(4 m) holds; the printed limit for 0.1 deg/s is three times tighter than it gives.",
)
condition = "Fig 5.32, {}: condition number, median"
sampled = [report.found(condition.format(name)) for name in
           ("damping compensation", "reference model 3 / 3.674 kHz", "reference model 3 / 3 kHz")]  # fmt: skip
report.answer(
    "T20",
    claimed="spread of the singular values < 1e2, about 1e3, > 1e15 (Fig 5.32)",
    obtained=", ".join(f"{value:.3g}" for value in sampled) + " (medians, sampled loop with a 600 Hz tone)",
    reading=f"equal frequencies without the tone: rank "
    f"{report.found('Fig 5.32, 3 / 3 kHz, motion without the tone: rank of 8')} of 8, a spread without limit",
    verdict=PARTLY,
    why="The order of the three is right; about 1e3 is reached at instants only, and the tone itself tells a little.",
)
report.finish()
