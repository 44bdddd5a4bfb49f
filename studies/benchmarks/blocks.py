"""How fast is the loop in blocks on this device? Prints the device and rows; needs what the loop itself imports.

    python studies/benchmarks/blocks.py --dies 8192 65536 --duration 0.1

The dies are alike and differ in their noise. The first samples of a run, one by one, are part of the time; a second row
leaves them out, by a run of ten times as many blocks. Kernels are what the compiled program starts one after the other:
of a block those by which the longer run has more, without those that make maps anew, which are told apart.
"""

import argparse
import re
import time
from typing import NamedTuple

from memsgyro_jax.base import runtime


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--dies", type=int, nargs="+", default=[32], help="side by side; 32 suit a core, 65536 a GPU")
    parser.add_argument("--duration", type=float, default=0.1, help="of each die's run, in s")
    parser.add_argument("--length", type=int, default=512, help="samples of a block")
    parser.add_argument("--repeat", type=int, default=3)
    parser.add_argument("--quick", action="store_true", help="once, 20 ms")
    options = parser.parse_args()
    if options.quick:
        options.duration, options.repeat = 0.02, 1
    runtime.configure(devices=1)
    import jax

    print(f"{jax.devices()[0].device_kind} ({jax.default_backend()}), jax {jax.__version__}")
    for dies in options.dies:
        short, long = (timed(times, dies, options) for times in (1, 10))
        whole = dies * options.duration / short.seconds
        inside = dies * (long.samples - short.samples) * 1e-5 / (long.seconds - short.seconds)
        each = (long.kernels - short.kernels) / (long.blocks - short.blocks)
        print(f"{dies} dies of {options.duration:g} s in {short.seconds:.4g} s, compiled in {short.compiling:.1f} s")
        print(f"  {whole:.4g} die-seconds per second, {inside:.4g} without the start")
        print(f"  {each:.0f} kernels a block, {long.of_maps} to make maps")
        print(f"  rate error over claimed standard deviation: {short.error:.3f} (1: as the filter claims)")


class Timed(NamedTuple):
    """A run of so many samples and blocks: its seconds, those of compiling it, its kernels but those of making maps,
    and the root mean square of the rate's normalised error at its end.
    """

    samples: int
    blocks: int
    seconds: float
    compiling: float
    kernels: int
    of_maps: int
    error: float


def timed(times: int, dies: int, options: argparse.Namespace) -> Timed:
    """A run with so many times the blocks."""
    import equinox as eqx
    import jax
    import jax.numpy as jnp
    import numpy as np

    import memsgyro_jax as mg
    from memsgyro_jax.loop import engine, noise
    from memsgyro_jax.loop.blocks.length import lengths
    from memsgyro_jax.loop.blocks.run import prepared, run_in_blocks

    class Nothing(engine.AbstractRecorder[tuple, tuple]):
        """Keeps nothing."""

        def init(self):
            return ()

        def sample(self, memory, sample):
            return ()

        def block(self, memory):
            return (), ()

    gyro, readout = mg.SingleMassGyro.chi2010(), mg.ChargeAmplifier.chi2010()
    observer = mg.ExtendedKalmanFilter.for_device(gyro, readout, annealing=mg.Annealing())
    controller = mg.DampingCompensation(tones=mg.Tone(600.0, 53.95))
    loop = mg.ClosedLoop(gyro, readout, observer, controller).in_blocks(options.length)
    loop, _ = prepared(loop.sampled_at(100e3, duration=options.duration))
    samples = round(100e3 * options.duration)
    first, lead = loop.blocks.first(samples)
    blocks = times * ((samples - first - lead) // options.length)
    sizes = lengths(first, lead, options.length, 1, blocks)

    @eqx.filter_jit
    def run(words):
        state = run_in_blocks(loop, mg.Scenario(rate=mg.Constant(1.0)), words, 1e-5, (1, first), sizes, Nothing()).state
        estimate = loop.observer.estimate(state.observer)
        return (estimate.rate - 1.0) / jnp.sqrt(estimate.rate_variance)

    words = noise.die_words(jax.random.key(0), jnp.arange(dies))
    began = time.perf_counter()
    program = run.lower(words).compile()
    compiling, best = time.perf_counter() - began, float("inf")
    error = jax.block_until_ready(program(words))
    for _ in range(options.repeat):
        began = time.perf_counter()
        jax.block_until_ready(program(words))
        best = min(best, time.perf_counter() - began)
    kernels, of_maps = kernels_of(program.compiled.as_text())
    normalised = float(np.sqrt(np.mean(np.asarray(error) ** 2)))
    return Timed(first + int(sizes.sum()), int((sizes > 0).sum()), best, compiling, kernels, of_maps, normalised)


_INSTRUCTION = re.compile(r"^\s+(?:ROOT )?%?[\w.\-]+ = (?:\(.*?\)|\S+) ([a-z][a-z\-]*)\((.*)$")
_NO_KERNELS = {
    "parameter", "constant", "tuple", "get-tuple-element", "bitcast", "after-all", "partition-id", "opt-barrier",
}  # fmt: skip


def kernels_of(program: str) -> tuple[int, int]:
    """How many kernels a compiled program starts but for the longer branches of conditions, and the longest of these.

    A loop counts as often as it is known to turn, else once.
    """
    computations: dict[str, list[str]] = {}
    current = ""
    for line in program.splitlines():
        if line.endswith("{") and (named := re.match(r"(?:ENTRY )?%?([\w.\-]+) \(", line)):
            current = "ENTRY" if line.startswith("ENTRY") else named[1]
            computations[current] = []
        elif current:
            computations[current].append(line)
    longest = 0

    def count(name: str) -> int:
        nonlocal longest
        total = 0
        for line in computations.get(name, ()):
            if not (found := _INSTRUCTION.match(line)) or found[1] in _NO_KERNELS:
                continue
            if found[1] == "while":
                turns = re.search(r'"known_trip_count":\{"n":"(\d+)"', line)
                total += (int(turns[1]) if turns else 1) * count(_called(line, "body"))
            elif found[1] == "call":
                total += count(_called(line, "to_apply"))
            elif found[1] == "conditional":
                few, *_, many = sorted(count(branch) for branch in _branches(line))
                longest, total = max(longest, many), total + few
            else:
                total += 1
        return total

    return count("ENTRY"), longest


def _called(line: str, what: str) -> str:
    found = re.search(rf"{what}=%?([\w.\-]+)", line)
    return found[1] if found else ""


def _branches(line: str) -> list[str]:
    if listed := re.search(r"branch_computations=\{([^}]*)\}", line):
        return [name.strip().lstrip("%") for name in listed[1].split(",")]
    return [_called(line, f"{which}_computation") for which in ("true", "false")]


if __name__ == "__main__":
    main()
