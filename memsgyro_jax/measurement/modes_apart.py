"""The two modes of a free vibration that both of two channels show, each by itself."""

import numpy as np
from scipy.signal import hilbert


def modes_apart(time: np.ndarray, signals: np.ndarray, omega: float, rows: int) -> np.ndarray:
    """Phasors (n, 2) of the modes of readings (n, 2) of two channels that die out.

    Each channel shows some of both, so that what it shows most changes when one is gone, though neither frequency
    does. The phasors of both channels after some time are a matrix times those before, whose eigenvectors the modes
    are: the matrix of least squares, over the time by which its eigenvalues come farthest apart.

    Args:
        time: (n,) even [s].
        signals: real, or phasors beside a reference.
        omega: of the louder one, beside the reference of phasors [rad/s].
        rows: over which means are taken against noise, less than the modes take to beat.
    """
    waves = signals if np.iscomplexobj(signals) else hilbert(signals - signals.mean(axis=0), axis=0)
    still = waves * np.exp(-1j * omega * time)[:, None]
    blocks = still[: len(still) // rows * rows].reshape(-1, rows, 2).mean(axis=1)
    found = []
    for lag in 2 ** np.arange(max(1, int(np.log2(max(len(blocks) // 4, 1))))):
        step = np.linalg.lstsq(blocks[:-lag], blocks[lag:], rcond=None)[0].T
        factors, shapes = np.linalg.eig(step)
        found.append((abs(factors[0] - factors[1]) / max(np.sum(np.abs(factors)), 1e-300), shapes))
    _, shapes = max(found, key=lambda one: one[0])
    return waves @ np.linalg.pinv(shapes).T
