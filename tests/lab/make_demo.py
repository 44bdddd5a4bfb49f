"""Writes the demonstration case that the package ships: `PYTHONPATH=tests python tests/lab/make_demo.py [FOLDER]`."""

import sys
from pathlib import Path

import numpy as np
from lab.die import Die, Hidden
from lab.laboratory import make_case
from lab.protocol import Laboratory


SEED = 20
HIDDEN = Hidden(cubic_stiffness_x=1.5e9)


def main(folder):
    """A die from the middle of its tolerances with one nonlinear spring, the same files on every run."""
    return make_case(folder, Die.drawn(np.random.default_rng(SEED)), HIDDEN, SEED, Laboratory.demo())


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "memsgyro_jax/demo"))
