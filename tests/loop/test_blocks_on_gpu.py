"""The loop in blocks, lowered for a GPU where there is none."""

import jax
import jax.numpy as jnp

import memsgyro_jax as mg
from memsgyro_jax.loop import noise
from memsgyro_jax.loop.blocks.length import lengths
from memsgyro_jax.loop.blocks.run import prepared, run_in_blocks
from memsgyro_jax.montecarlo.batch import LotRecorder


def test_a_gpu_is_asked_for_nothing_but_array_operations():
    """Lowered for CUDA there is no call back to Python and none into a library, and a block's loops are those of its
    maps and of its statistics. On an H200 that of `studies/benchmarks/blocks.py` was 87 kernels a block.
    """
    gyro, readout = mg.SingleMassGyro.chi2010(), mg.ChargeAmplifier.chi2010()
    observer = mg.ExtendedKalmanFilter.for_device(gyro, readout, annealing=mg.Annealing())
    made = mg.ClosedLoop(gyro, readout, observer, mg.DampingCompensation(tones=mg.Tone(600.0, 53.95)))
    loop, _ = prepared(made.in_blocks(512).sampled_at(100e3, duration=0.05))
    first, lead = loop.blocks.first(5000)
    sizes = lengths(first, lead, 512, 1, 7)

    def run(words):
        ran = run_in_blocks(loop, mg.Scenario(rate=mg.Constant(1.0)), words, 1e-5, (1, first), sizes, LotRecorder(0.3))
        return loop.rate(ran.state)

    words = noise.die_words(jax.random.key(0), jnp.arange(64))
    program = jax.jit(run).trace(words).lower(lowering_platforms=("cuda",)).as_text()
    assert "custom_call" not in program
    assert 0 < program.count("stablehlo.while") <= 7
