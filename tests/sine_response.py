"""What a sine of the rate adds to the estimate of a loop, beside the same noise without it."""

import numpy as np

import memsgyro_jax as mg


def told_and_seen(loop, frequency):
    """The response to a sine of `frequency` [Hz] that a trace tells, and the one over the later half of a run."""
    decimation = loop.blocks.length if loop.blocks else 50
    settings = {"sample_rate": 100e3, "duration": 0.4, "seed": 1, "decimation": decimation}
    moving, still = (mg.simulate(loop, mg.Sine(size, frequency), **settings) for size in (0.3, 0.0))
    late = np.asarray(still.time) > 0.2
    phase = 2.0 * np.pi * frequency * np.asarray(still.time)[late]
    added = np.asarray(moving.rate_estimate - still.rate_estimate)[late] / 0.3
    parts = np.linalg.lstsq(np.stack([np.sin(phase), np.cos(phase)], axis=1), added, rcond=None)[0]
    return complex(still.rate_response(frequency)), complex(*parts)
