"""What does a gradient through the closed loop cost? Runs of the lot it is worth, memory, compile time.

By few numbers the derivatives go forwards: every sample carries one by each number along, nothing of the run is stored.
By more they go backwards through kept states, one way back for all numbers. The primal is the plain
run with the loss recorded, whichever way the derivatives go. With `--blocks` the loop goes in blocks, backwards always.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path


NAMES = ("rate", "kxx", "kyy", "kxy", "dxx", "dyy", "dxy", "sigma")


def worker(options: argparse.Namespace) -> None:
    """One process on one core; prints JSON."""
    from memsgyro_jax.base import runtime

    runtime.configure(devices=1)
    import numpy as np

    import memsgyro_jax as mg
    from memsgyro_jax import losses
    from memsgyro_jax.loop.blocks.run import prepared
    from memsgyro_jax.tuning.objective import Objective
    from memsgyro_jax.tuning.tunable import resolved
    from memsgyro_jax.tuning.tune import timing_of

    gyro, readout = mg.SingleMassGyro.chi2010(), mg.ChargeAmplifier.chi2010()
    noise = mg.ProcessNoise.of(gyro.model, rate=100.0)
    observer = mg.ExtendedKalmanFilter.for_device(gyro, readout, annealing=mg.Annealing(), process_noise=noise)
    loop = mg.ClosedLoop(gyro, readout, observer, mg.DampingCompensation(tones=mg.Tone(600.0, 53.95)))
    loop = loop.sampled_at(100e3)
    if options.blocks:
        loop, _ = prepared(loop.in_blocks())
    free = ("noise_density", *(f"process_noise.{name}" for name in NAMES))
    duration = options.steps / 100e3

    def objective(count: int) -> Objective:
        """By two noise densities and spectra of process noise, `count` numbers in all."""
        tunables = resolved(loop, mg.free(observer=free[: count - 1]), 100e3, duration)
        return Objective.of(
            loop, mg.Scenario(rate=mg.Constant(1.0)), mg.Spread.relative(0.15), tunables,
            losses.SquaredRateError(0.5 * duration), dies=np.arange(options.dies),
            timing=timing_of(100e3, duration, 0.5 * duration), seed=0, lanes=options.lanes,
        )  # fmt: skip

    plain, made = objective(2), objective(options.numbers)

    def timed(function, numbers: np.ndarray) -> tuple[float, float]:
        """Processor seconds of the first call less a later one, and of the fastest later one."""
        spent = []
        for _ in range(1 + options.repeat):
            began = time.process_time()
            function(numbers)
            spent.append(time.process_time() - began)
        return spent[0] - min(spent[1:]), min(spent[1:])

    first, primal = timed(plain.values, plain.tunables.values)
    made.values(made.tunables.values)  # whoever wants a gradient has asked for the loss before
    compiling, gradient = timed(made.slopes, made.tunables.values)
    memory = made.memory(derivative=True) / 1e6
    print(json.dumps({"primal_s": primal, "gradient_s": gradient, "ratio": gradient / primal, "memory_mb": memory,
                      "compile_primal_s": first, "compile_gradient_s": compiling}))  # fmt: skip


def start(numbers: int, options: argparse.Namespace) -> dict:
    """A fresh process pinned to one core, with an empty cache."""
    environment = {k: v for k, v in os.environ.items() if not k.startswith(("XLA_FLAGS", "JAX_", "MEMSGYRO_"))}
    core = sorted(os.sched_getaffinity(0))[-1]
    with tempfile.TemporaryDirectory() as cache:
        done = subprocess.run(
            [sys.executable, __file__, "--worker", f"--numbers={numbers}", f"--dies={options.dies}",
             f"--steps={options.steps}", f"--repeat={options.repeat}", f"--lanes={options.lanes}",
             *(["--blocks"] if options.blocks else [])],
            env=environment | {"XDG_CACHE_HOME": cache, "OMP_NUM_THREADS": "1"}, capture_output=True, text=True,
            check=False, preexec_fn=lambda: os.sched_setaffinity(0, [core]),
        )  # fmt: skip
    if done.returncode:
        sys.exit(done.stderr[-2000:])
    return json.loads(done.stdout[done.stdout.index("{") :])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--dies", type=int, default=64)
    parser.add_argument("--steps", type=int, default=10_000)
    parser.add_argument("--lanes", type=int, default=32, help="dies side by side")
    parser.add_argument("--repeat", type=int, default=4, help="timed calls; the fastest counts")
    parser.add_argument("--numbers", type=int, nargs="+", default=[3, 6, 10])
    parser.add_argument("--blocks", action="store_true", help="the loop in blocks")
    parser.add_argument("--out", type=Path, default=Path(__file__).parents[1] / "out" / "gradient")
    parser.add_argument("--worker", action="store_true", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.worker:
        options.numbers = options.numbers[0]
        return worker(options)
    load = os.getloadavg()[0]
    found = {numbers: start(numbers, options) for numbers in options.numbers}
    print(f"{options.dies} dies, {options.steps} steps, one core; load of the machine before: {load:.1f}")
    print("numbers  primal  gradient  ratio (<= 10)  MB per die (<= 0.3)  compile (< 15 s)")
    for numbers, one in found.items():
        print(f"{numbers:7d}  {one['primal_s']:5.2f}s  {one['gradient_s']:7.2f}s  {one['ratio']:13.1f}  "
              f"{one['memory_mb']:19.3f}  {one['compile_gradient_s']:15.1f}s")  # fmt: skip
    options.out.mkdir(parents=True, exist_ok=True)
    (options.out / "gradient.json").write_text(json.dumps({"load_before": load, "by_numbers": found}, indent=1))
    return None


if __name__ == "__main__":
    main()
