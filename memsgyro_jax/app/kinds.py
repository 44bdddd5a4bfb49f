"""The kinds of observer and controller that a study file can name: told by `memsgyro sweep --help` without JAX."""

KINDS = {
    "observer": {
        "ekf": "extended Kalman filter, with a covariance",
        "block_ekf": "the same, takes a block of samples at a time: a tenth of the operations, for records",
        "scale_ratio": "the same, finds the ratio of the read-out's scales too",
        "rate_slope": "the same, finds how fast the rate changes too",
        "known_rate": "the same, learns unequal cross damping while the rate is known",
        "lyapunov": "the thesis' own, of a velocity read-out",
        "energy_lyapunov": "the same with an energy state",
        "none": "for a controller that measures by itself",
    },
    "controller": {
        "damping_compensation": "cancels the estimated damping",
        "reference_model": "makes each axis an oscillator of its own frequency",
        "designed_motion": "holds the mass on a sum of tones",
        "whole_angle": "lets the mass vibrate freely, for direct angle measurement",
        "sliding_mode": "adaptive, holds a sum of tones and measures by itself",
        "open_loop": "forces that ignore the estimate",
        "classic": "phase-locked drive and a demodulated or rebalanced axis; measures by itself",
    },
}


def kinds_text() -> str:
    """The table as lines."""
    return "\n".join(
        f"{part} kinds of a study file:\n" + "\n".join(f"  {kind}: {text}" for kind, text in kinds.items())
        for part, kinds in KINDS.items()
    )
