"""In which motion does a gyro tell its rate best, and what if the model of it is not quite right?

Frequencies, shapes and phases of a few tones are chosen by gradient of the information bound, within 1 µm, once for a
model that is right and once for stated errors of it; 128 dies then move as designed in the closed loop.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
from _common import Report, dps, rms
from rich.console import Console
from rich.table import Table

import memsgyro_jax as mg
from memsgyro_jax.base import runtime
from memsgyro_jax.loop import engine, noise
from memsgyro_jax.loop.scenario import as_scenario


runtime.configure()

RATE, SAMPLE_RATE, DURATION = 1.0, 100e3, 0.1
GYRO, READOUT = mg.SingleMassGyro.chi2010(), mg.ChargeAmplifier.chi2010()
NONE, CROSS_AND_GAIN, ALL = mg.ModelErrors.none(), mg.ModelErrors(delay=0.0), mg.ModelErrors()
FINDABLE = mg.ModelErrors(cross_damping=0.0)
KNOWN = {"known": ("sigma",)}  # two tones tell eight numbers: all coefficients but that of the mass
SPREAD = mg.Spread.relative(0.15)
KNOWLEDGE = 0.1  # of the usual prior, 1.5 % of each coefficient: the estimate by which the motion was aimed
NOISES = 4  # each die that has a right model is run with


class Peak(engine.AbstractRecorder):
    """The largest displacement of either axis."""

    def init(self):
        return jnp.zeros(())

    def sample(self, memory, sample):
        return jnp.maximum(memory, jnp.maximum(abs(sample.motion[0]), abs(sample.motion[1])))

    def block(self, memory):
        return memory, ()


def fabricated(count: int) -> list[mg.SingleMassGyro]:
    """Dies of 15 % spread."""
    loop = mg.ClosedLoop(GYRO, READOUT, mg.ExtendedKalmanFilter.for_device(GYRO, READOUT), mg.OpenLoop())
    drawn = SPREAD.draw(loop, as_scenario(RATE), 1, np.arange(count)).loop.device
    names = ("mass", "kxx", "kyy", "kxy", "dxx", "dyy", "dxy")
    return [mg.SingleMassGyro(*(float(getattr(drawn, name)[i]) for name in names)) for i in range(count)]


def wrong(gyro: mg.SingleMassGyro, errors: mg.ModelErrors, draw: np.ndarray) -> mg.AbstractGyro:
    """The gyro with the errors drawn (five normal numbers), beside the symmetric part that a filter would find."""
    asymmetry, *rest = errors.std(GYRO) * draw
    dxy = gyro.dxy - 0.5 * asymmetry * gyro.mass
    gyro = mg.SingleMassGyro(gyro.mass, gyro.kxx, gyro.kyy, gyro.kxy, gyro.dxx, gyro.dyy, dxy,
                             dyx=dxy + asymmetry * gyro.mass)  # fmt: skip
    return mg.UncertainGyro(gyro, tuple(rest[:2]), tuple(rest[2:])) if np.any(errors.std(GYRO)[1:]) else gyro


def started(loop: mg.ClosedLoop, rng: np.random.Generator) -> mg.ClosedLoop:
    """The filter begins beside the truth, as its prior says; what the errors of the model add to it begins at zero."""
    prior, names = loop.observer.prior, loop.observer.model.names
    own = [name != "rate" and name in GYRO.model.names for name in names]
    share = [KNOWLEDGE if mine else 1.0 for mine in own]
    moved = [mine and i in loop.observer.estimated for i, mine in enumerate(own)]
    std = tuple(s * p for s, p in zip(share, prior.theta_std, strict=True))
    theta = tuple(t + m * s * rng.standard_normal() for t, s, m in zip(prior.theta, std, moved, strict=True))
    motion_std = tuple(KNOWLEDGE * s for s in prior.motion_std)
    motion = tuple(m + s * rng.standard_normal() for m, s in zip(prior.motion, motion_std, strict=True))
    told = mg.Prior(motion, motion_std, prior.offset, prior.offset_std, theta, std)
    return eqx.tree_at(lambda made: made.observer.prior, loop, told)


go = eqx.filter_jit(engine.run)


def run(design: mg.MotionDesign, dies: list[mg.SingleMassGyro]) -> tuple:
    """Errors of the rate at the end [rad/s], the bound of the designed motion, the Bayesian bound of the very runs
    where the model is right (what is left of the start tells of the rate too), and the largest displacement [m].
    """
    rng = np.random.default_rng(5)
    aimed = [design.aimed_at(gyro) for gyro in dies]
    loops = [
        started(own.closed_loop(wrong(gyro, design.errors, rng.standard_normal(5))), rng)
        for own, gyro in zip(aimed, dies, strict=True)
    ]
    plain = started(design.closed_loop(), np.random.default_rng(0)).sampled_at(SAMPLE_RATE)
    batch = jax.tree.map(
        lambda *leaves: jnp.stack(leaves, axis=-1), *(loop.sampled_at(SAMPLE_RATE, plain) for loop in loops)
    )
    blocks, right = round(DURATION * SAMPLE_RATE) // 100, not np.any(design.errors.std(GYRO))
    error, peak = [], 0.0
    for seed in range(NOISES if right else 1):  # where the model has errors, these are what dies differ in
        words = noise.die_words(jax.random.key(seed), jnp.arange(len(dies)))
        done = go(batch, as_scenario(RATE), words, 1.0 / SAMPLE_RATE, blocks, 100, Peak(), plain)
        alive = np.asarray(done.alive)
        if not alive.all():
            print(f"{np.sum(~alive)} of {len(dies)} dies were lost")
        error.append((np.asarray(batch.rate(done.state)) - RATE)[alive])
        peak = max(peak, float(np.max(done.memory)))
    error, bound = np.concatenate(error), float(rms([own.bound() for own in aimed]))
    if not right:
        return error, bound, None, peak
    found = mg.information_bound(batch, RATE, prior=plain.observer.prior, windows=1, design=plain, **KNOWN)
    return error, bound, float(rms(found.rate_std[-1])), peak


report = Report()
search = {"starts": 8, "steps": 120} if report.quick else {}

nominal = mg.design_motion(GYRO, READOUT, tones=2, errors=NONE, **KNOWN, **search)
own_axis = mg.design_motion(GYRO, READOUT, tones=2, own_axis=True, errors=NONE, **KNOWN, **search)
for_gain = mg.design_motion(GYRO, READOUT, errors=CROSS_AND_GAIN, **search)
for_findable = mg.design_motion(GYRO, READOUT, errors=FINDABLE, **search)
robust = mg.design_motion(GYRO, READOUT, **search)
print(robust)

lower, upper = mg.mode_frequencies(GYRO)
apart = [[1e-6, 0.0], [0.0, -1e-6j]]
designs = {
    "3 kHz along x, 5 kHz along y": own_axis.with_tones([3000.0, 5000.0], apart),
    "each axis at the other's mode": own_axis.with_tones([upper, lower], apart),
    "designed, one tone per axis": own_axis,
    "designed, right model": nominal,
    "designed for cross damping and gain": for_gain,
    "designed for gain and delay": for_findable,
    "designed for all three (default)": robust,
}

thesis = mg.default_study().loop
start = dps(mg.information_bound(thesis, RATE, windows=1).rate_std[-1])
report.row(
    "bound of the rate, thesis' start [deg/s]", 6.47, float(start), "1 µm along x swings on, 600 Hz on both axes"
)
for name, claim, remark in (
    ("3 kHz along x, 5 kHz along y", 4.58, "as the thesis' reference model"),
    ("each axis at the other's mode", 1.06, ""),
    ("designed, one tone per axis", "<= 1.0", f"{own_axis.agreeing} of {own_axis.starts} starts agree"),
    ("designed, right model", 0.027, f"{nominal.agreeing} of {nominal.starts}: mode shapes"),
):  # fmt: skip
    report.row(f"  {name}", claim, float(dps(designs[name].bound())), remark)
shape = "not designed for it, one tone per axis"
report.row("with cross damping ± 10 %, gain ± 1 %", "<= 2.9", float(dps(for_gain.bound())),
           "2.86 are the cross damping's own: no motion tells it from a rate")  # fmt: skip
report.row(
    f"  {shape}", 8.5, float(dps(own_axis.bound(CROSS_AND_GAIN))), "two independent gains of 1 % do no more here"
)
report.row(
    "with delays ± 0.1 µs as well", "<= 3.4", float(dps(robust.bound())), f"{robust.agreeing} of {robust.starts} agree"
)
report.row(f"  {shape}", 144.0, float(dps(own_axis.bound(ALL))), "kxy · delay is the force of a rate")
report.row("  nominal design of four tones", "", f"{dps(robust.nominal.bound(ALL)):.5g}",
           f"against {dps(robust.bound()):.5g}: designing for these errors gains nothing")  # fmt: skip

dies = fabricated(16 if report.quick else 128)
frozen, aimed = (
    np.array([each.bound(NONE, gyro) for each, gyro in zip(made, dies, strict=True)])
    for made in ([nominal] * len(dies), [nominal.aimed_at(gyro) for gyro in dies])
)
report.row("with gain ± 1 % and delays ± 0.1 µs alone", "", float(dps(for_findable.bound())),
           "the filter finds both while it finds the rate")  # fmt: skip
report.row("15 % spread, the same motion for all [deg/s]", 0.90, float(dps(np.median(frozen))),
           f"right model, median; root mean square {dps(rms(frozen)):.3g}")  # fmt: skip
report.row(
    "  aimed at the modes of each die", 0.027, float(dps(np.median(aimed))), f"root mean square {dps(rms(aimed)):.3g}"
)

runs = ["designed for all three (default)"]
if not report.quick:
    runs = ["designed, one tone per axis", "designed, right model", "designed for cross damping and gain",
            "designed for gain and delay", *runs]  # fmt: skip
errors = {}
for name in runs:
    error, bound, own, peak = run(designs[name], dies)
    errors[name] = error, bound
    ratio, spread = rms(error) / bound, 1.0 / np.sqrt(2.0 * len(error))
    claim = "" if designs[name] is for_findable else "<= 1.1"
    beside = "" if own is None else f" (with all that the runs and the prior tell {dps(own):.3g})"
    report.row(f"filter on {len(dies)} dies over bound: {name}", claim, f"{ratio:.3f} ± {ratio * spread:.3f}",
               f"{dps(rms(error)):.3g} deg/s, bound {dps(bound):.3g}{beside}; up to {1e6 * peak:.2f} µm")  # fmt: skip

combinations = [mg.ModelErrors(c, g, d) for c in (0.0, 0.1) for g in (0.0, 0.01) for d in (0.0, 0.1e-6)]
table = Table("bound of the rate [deg/s]", *map(str, combinations), title="every design under every error of the model")
bounds = {name: [float(dps(design.bound(each))) for each in combinations] for name, design in designs.items()}
for name, row in bounds.items():
    table.add_row(name, *(f"{value:.3g}" for value in row))
console = Console(record=True, width=150)
console.print(table)
console.save_text(str(report.folder / "combinations.txt"))

figure, ((left, right), (low_left, low_right)) = plt.subplots(2, 2, figsize=(12.5, 8.5), layout="constrained")
places = np.arange(len(designs))
for column, label in ((0, "right model"), (-2, "cross damping ± 10 %, gain ± 1 %"), (-1, "and delays ± 0.1 µs")):
    left.plot([row[column] for row in bounds.values()], places, "osD"[column], ms=7, label=label)
left.axvline(start, color="0.5", ls="--", lw=1.0, label="thesis' start, right model")
left.set(xscale="log", xlabel="bound of the rate after 0.1 s [deg/s]", yticks=places, yticklabels=list(designs))
left.invert_yaxis()
left.legend(fontsize=8, loc="upper center", bbox_to_anchor=(0.4, -0.13), ncols=2, frameon=False)
nominal.plot(right)
right.set_title("designed for a right model")
robust.plot(low_right)
low_right.set_title("designed for all three errors")
for number, (name, (error, bound)) in enumerate(errors.items()):
    low_left.plot(
        np.sort(np.abs(error)) / bound, (np.arange(len(error)) + 0.5) / len(error), color=f"C{number}", label=name
    )
at = np.linspace(0.0, 3.0, 200)
low_left.plot(at, jax.scipy.special.erf(at / np.sqrt(2.0)), "k--", lw=1.0, label="normal, of the bound's deviation")
low_left.set(
    xlabel="size of the filter's error over the bound", ylabel="share of dies", xlim=(0.0, 3.2), ylim=(0.0, 1.0)
)
low_left.legend(fontsize=8, frameon=False, loc="lower right")
report.picture(figure, "designed_motion")
report.finish()
