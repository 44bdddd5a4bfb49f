"""How fast is the loop in blocks on this device? Prints the device and a row; needs what the loop itself imports.

    python studies/benchmarks/blocks.py --dies 8192 --duration 0.1

The dies are alike and differ in their noise. The first samples of a run, one by one, are part of the time; a second row
leaves them out, by a run of ten times as many blocks.
"""

import argparse
import time

from memsgyro_jax.base import runtime


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--dies", type=int, default=32, help="side by side; 32 suit a core, 8192 a GPU")
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
    (short, samples, compiled, error), (long, more, _, _) = (timed(times, options) for times in (1, 10))
    whole = options.dies * options.duration / short
    inside = options.dies * (more - samples) * 1e-5 / (long - short)
    print(f"{options.dies} dies of {options.duration:g} s in {short:.4g} s, compiled in {compiled:.1f} s")
    print(f"  {whole:.4g} die-seconds per second, {inside:.4g} without the start")
    print(f"  rate error over claimed standard deviation: {error:.3f} (below 1: the dies are what the filter assumes)")


def timed(times: int, options: argparse.Namespace) -> tuple[float, int, float, float]:
    """Seconds of a run with so many times the blocks, its samples, seconds of compiling it, and the root mean square of
    the rate's normalised error at its end.
    """
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

    words = noise.die_words(jax.random.key(0), jnp.arange(options.dies))
    began = time.perf_counter()
    error = jax.block_until_ready(run(words))
    compiling, best = time.perf_counter() - began, float("inf")
    for _ in range(options.repeat):
        began = time.perf_counter()
        jax.block_until_ready(run(words))
        best = min(best, time.perf_counter() - began)
    return best, first + int(sizes.sum()), compiling - best, float(np.sqrt(np.mean(np.asarray(error) ** 2)))


if __name__ == "__main__":
    main()
