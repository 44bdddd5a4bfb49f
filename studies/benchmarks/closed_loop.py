"""How fast is a sweep? The public `sweep` on the default study, beside hand-written yardsticks where there are any.

`--yardstick DIR` names a folder whose `run.py` prints JSON of the form {"name": {"steps_per_s": ...}}; it is run pinned
to the same core, turn by turn with ours, and the fastest turns of both are compared by processor time (by wall clock, a
busy machine would decide). Where there is an accelerator, `--many` dies run on it too, sample by sample and in blocks,
by wall clock; all else runs on processors. What is being run is said on the way: all of it takes a quarter of an hour.
What differs in the work: the sweep draws its own noise by (die, sample), steps plant and filter by the exact
exponential, anneals the measurement variance, and gathers NIS, convergence and window statistics of every die; a
yardstick does what its own description says, typically a 4th-order Taylor step and fading instead of annealing.
"""

import argparse
import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path


LENGTHS = {"in blocks": 1.0, "in blocks, runs ten times as long": 10.0}


def worker(options: argparse.Namespace) -> None:
    """One process as a user would start it: import, first sweep, repeated sweeps; prints JSON."""
    began = time.perf_counter()
    if options.no_flags:
        os.environ["JAX_ENABLE_X64"] = "1"
    else:
        from memsgyro_jax.base import runtime

        runtime.configure(devices=options.cores)
    import memsgyro_jax as mg

    def loop(*effects) -> mg.ClosedLoop:
        gyro, readout = mg.SingleMassGyro.chi2010(), mg.ChargeAmplifier.chi2010()
        if options.classic:
            control = mg.ClassicControl.force_rebalance(gyro, readout, amplitude=1e-6)
            return mg.ClosedLoop(gyro, readout, mg.NoObserver.for_device(gyro, readout), control, (0.0,) * 4)
        observer = mg.ExtendedKalmanFilter.for_device(gyro, readout, annealing=mg.Annealing())
        controller = mg.DampingCompensation(tones=mg.Tone(600.0, 53.95))
        return mg.ClosedLoop(gyro.with_effect(*effects), readout, observer, controller)

    def sweep(*effects) -> None:
        spread, settings = mg.Spread.relative(0.15), {"dies": options.dies, "duration": options.duration}
        made = loop(*effects).in_blocks() if options.blocks else loop(*effects)
        mg.sweep(made, spread, 1.0, bound_dies=0, **settings)

    if options.effects:
        return print(json.dumps(costs(sweep, options.repeat)))
    sweep()
    first, steps = time.perf_counter() - began, options.dies * round(options.duration * 100e3)
    wall, processor, alone = [], [], []
    for _ in range(options.repeat):
        clock, used, own = time.perf_counter(), time.process_time(), time.thread_time()
        sweep()
        wall.append(time.perf_counter() - clock)
        processor.append(time.process_time() - used)
        alone.append(time.thread_time() - own)
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0
    speeds = {"steps_per_s": steps / min(processor), "steps_per_wall_s": steps / min(wall),
              "serial_share": min(alone) / min(processor)} if wall else {}  # fmt: skip
    return print(json.dumps({"first_call_s": first, "peak_memory_mib": memory, **speeds}))


def costs(sweep: Callable[..., None], repeat: int) -> dict[str, float]:
    """Processor time of a sweep with an effect over that without, for the first variant of each, turn by turn.

    The strengths are too small to change a run, which would cost the same at any other.
    """
    import equinox as eqx

    import memsgyro_jax as mg

    every = {type(effect): effect for effect in reversed(mg.effects.catalogue())}
    kinds = [kind for kind in mg.effects.CATALOGUE if not issubclass(kind, mg.effects.SweepEffect)]
    faint = [eqx.tree_at(lambda e: e.strength, every[kind], 0.0 * every[kind].strength + 1e-30) for kind in kinds]
    cases = {"none": (), **{effect.label: (effect,) for effect in faint}}
    best = dict.fromkeys(cases, float("inf"))
    for turn in range(1 + repeat):  # the first turn compiles
        for name, effects in cases.items():
            used = time.process_time()
            sweep(*effects)
            best[name] = min(best[name], time.process_time() - used) if turn else best[name]
    return {name: spent / best["none"] for name, spent in best.items() if name != "none"}


def start(
    *arguments: str, cores: int, cache: str, program: tuple[str, ...] = (__file__, "--worker"), platform: str = "cpu"
) -> dict:
    """Runs Python on the first `cores` usable cores and reads the JSON that it prints last."""
    print(" ".join((Path(program[0]).name, *program[1:], *arguments)), file=sys.stderr, flush=True)
    allowed = sorted(os.sched_getaffinity(0))[-cores:]
    environment = {k: v for k, v in os.environ.items() if not k.startswith(("XLA_FLAGS", "JAX_", "MEMSGYRO_"))}
    environment |= {"XDG_CACHE_HOME": cache, "OMP_NUM_THREADS": "1", "JAX_PLATFORMS": platform}
    done = subprocess.run(
        [sys.executable, *program, *arguments], env=environment, capture_output=True, text=True, check=False,
        preexec_fn=lambda: os.sched_setaffinity(0, allowed),
    )  # fmt: skip
    if done.returncode:
        sys.exit(f"{' '.join(program)} failed:\n{done.stderr[-2000:]}")
    return json.loads(done.stdout[done.stdout.index("{") :])


def measure(options: argparse.Namespace, cache: str, accelerator: str) -> tuple[dict, dict]:
    """Our figures and the yardsticks' speeds; `accelerator` is JAX's name of it, empty where there is none."""
    job = ("--dies", str(options.dies), "--duration", str(options.duration), "--repeat", str(options.repeat))
    ours: dict = {"first_start": start(*job, cores=1, cache=cache)}
    pinned, yardsticks, blocks, classic = [], {}, {}, []  # type: list[dict], dict[str, list], dict[str, list], list[dict]
    for _ in range(options.turns):
        if options.yardstick:
            found = start(cores=1, cache=cache, program=(str(options.yardstick / "run.py"),))
            for name, value in found.items():
                if isinstance(value, dict) and "steps_per_s" in value:
                    yardsticks.setdefault(name, []).append(value["steps_per_s"])
        pinned.append(start(*job, cores=1, cache=cache))
        classic.append(start(*job, "--classic", cores=1, cache=cache))
        for name, times in LENGTHS.items():
            longer = (*job[:2], "--duration", str(times * options.duration), *job[4:], "--blocks")
            blocks.setdefault(name, []).append(start(*longer, cores=1, cache=cache))
    ours |= {name: max(runs, key=lambda run: run["steps_per_s"]) for name, runs in blocks.items()}
    gradient = (str(Path(__file__).with_name("gradient.py")), "--worker", "--blocks", "--numbers", "10")
    for name, times in LENGTHS.items():
        steps = str(round(times * options.duration * 100e3))
        ours[f"gradient {name}"] = start("--steps", steps, cores=1, cache=cache, program=gradient)
    ours["one_core"] = max(pinned, key=lambda run: run["steps_per_s"])
    ours["classic control"] = max(classic, key=lambda run: run["steps_per_s"])
    ours["second_start_s"] = min(run["first_call_s"] for run in pinned)
    ours["one_core_without_flags"] = start(*job, "--no-flags", cores=1, cache=cache)
    if len(os.sched_getaffinity(0)) > 1:
        for name, extra in {"two_cores": (), "two_cores in blocks": ("--blocks",)}.items():
            both = [start(*job, *extra, "--cores", "2", cores=2, cache=cache) for _ in range(options.turns)]
            ours[name] = max(both, key=lambda run: run["steps_per_wall_s"])
    if accelerator:
        many = ("--dies", str(options.many), *job[2:])
        for name, extra in {"accelerator": (), "accelerator in blocks": ("--blocks",)}.items():
            ours[name] = start(*many, *extra, cores=1, cache=cache, platform=accelerator)
    four = ("--dies", str(options.dies), "--duration", str(4.0 * options.duration), "--repeat", "0")
    ours["four_times_the_steps"] = start(*four, cores=1, cache=cache)
    fewer = ("--dies", str(-(-options.dies // 4)), *job[2:])
    ours["cost_of_effects"] = start(*fewer, "--effects", cores=1, cache=cache)
    return ours, {name: max(values) for name, values in yardsticks.items()}


def table(ours: dict, yardsticks: dict, options: argparse.Namespace) -> list[tuple[str, str]]:
    """What a person reads."""
    one, bare = ours["one_core"], ours["one_core_without_flags"]
    rows = [
        ("one core", f"{one['steps_per_s'] / 1e6:.2f} million steps/s"),
        ("one core without compiler flags", f"{bare['steps_per_s'] / 1e6:.2f} million steps/s"),
    ]
    for name in (*LENGTHS, "classic control"):
        speed = ours[name]["steps_per_s"]
        rows.append((name, f"{speed / 1e6:.2f} million samples/s, {speed / one['steps_per_s']:.2f} x one core"))
    for name in (f"gradient {length}" for length in LENGTHS):
        ratio, seconds = ours[name]["ratio"], ours[name]["compile_gradient_s"]
        rows.append((name, f"{ratio:.2f} x its primal by ten numbers, compiled in {seconds:.1f} s"))
    for name, alone in {"two_cores": one, "two_cores in blocks": ours["in blocks"]}.items():
        if name in ours:
            both, limit = ours[name]["steps_per_wall_s"], 2.0 / (1.0 + ours[name]["serial_share"])
            text = f"{both / 1e6:.2f} million steps/s, {both / alone['steps_per_wall_s']:.2f} x one core"
            text += f" ({limit:.2f} x if nothing that one thread does alone overlapped)"
            rows.append((f"{name.replace('_', ' ')}, wall clock", text))
    for name in [name for name in ours if name.startswith("accelerator")]:
        speed = ours[name]["steps_per_wall_s"]
        text = f"{speed / 1e6:.1f} million samples/s, {speed / one['steps_per_wall_s']:.1f} x one core"
        rows.append((f"{name}, {options.many} dies, wall clock", text))
    more = ours["four_times_the_steps"]["peak_memory_mib"] - ours["first_start"]["peak_memory_mib"]
    rows += [
        ("first call, nothing compiled yet", f"{ours['first_start']['first_call_s']:.1f} s from the start of Python"),
        ("first call, compiled before", f"{ours['second_start_s']:.1f} s from the start of Python"),
        ("memory for four times the steps", f"{1024.0 * more / options.dies:+.1f} KiB per die"),
    ]
    rows += [(f"cost of {name}", f"{ratio - 1.0:+.0%} of a step") for name, ratio in ours["cost_of_effects"].items()]
    for name, speed in yardsticks.items():
        with_flags, without = (run["steps_per_s"] / speed for run in (one, bare))
        rows.append(
            (f"against {name}", f"{with_flags:.3g} x, without flags {without:.3g} x (of {speed / 1e6:.4g} million)")
        )
        rows += [(f"  {length}", f"{ours[length]['steps_per_s'] / speed:.3g} x") for length in LENGTHS]
    if not yardsticks:
        rows.append(("against hand-written programs", "not measured: `--yardstick DIR` names none"))
    return rows


def accelerator_of_jax() -> str:
    """The platform that JAX prefers where it is no processor; asked in another process, which keeps it to itself."""
    asked = [sys.executable, "-c", "import jax; print(jax.devices()[0].platform)"]
    name = subprocess.run(asked, capture_output=True, text=True, check=True).stdout.split()[-1]
    return "" if name == "cpu" else {"gpu": "cuda"}.get(name, name)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--yardstick", type=Path, help="folder with a run.py to compare with")
    parser.add_argument("--dies", type=int, default=1024)
    parser.add_argument("--duration", type=float, default=0.1, help="of each die's run, in s")
    parser.add_argument("--many", type=int, default=8192, help="dies on an accelerator")
    parser.add_argument("--repeat", type=int, default=5, help="timed sweeps per process; the fastest counts")
    parser.add_argument("--turns", type=int, default=3, help="times that yardstick and sweep take turns")
    parser.add_argument("--out", type=Path, default=Path(__file__).parents[1] / "out" / "closed_loop")
    for hidden in ("--worker", "--no-flags", "--effects", "--blocks", "--classic"):
        parser.add_argument(hidden, action="store_true", help=argparse.SUPPRESS)
    parser.add_argument("--cores", type=int, default=1, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.worker:
        return worker(options)
    load, accelerator = os.getloadavg()[0], accelerator_of_jax()
    with tempfile.TemporaryDirectory() as cache:
        ours, yardsticks = measure(options, cache, accelerator)
    rows = table(ours, yardsticks, options)
    width = max(len(name) for name, _ in rows)
    print(f"{options.dies} dies, {options.duration:g} s at 100 kHz; load of the machine before: {load:.1f}")
    print("\n".join(f"  {name:<{width}}  {text}" for name, text in rows))
    options.out.mkdir(parents=True, exist_ok=True)
    record = {"ours": ours, "yardsticks": yardsticks, "load_before": load, "table": dict(rows)}
    (options.out / "closed_loop.json").write_text(json.dumps(record, indent=1))
    return None


if __name__ == "__main__":
    main()
