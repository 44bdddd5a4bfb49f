"""A frame of beam elements in the plane, and a squeezed film on a grid; complex numbers pass, for derivatives."""

import numpy as np
from scipy.sparse import diags_array as diags
from scipy.sparse import eye, kron
from scipy.sparse.linalg import spsolve


def frame(points, width, thickness, young):
    """(2, 2) stiffness at the last point, held from turning, of a chain of beams clamped at the first."""
    points = np.asarray(points)
    stiffness = np.zeros((3 * len(points),) * 2, complex)
    for k, (dx, dy) in enumerate(np.diff(points, axis=0)):
        size = np.sqrt(dx**2 + dy**2)
        c, s = dx / size, dy / size
        ea, ei = young * width * thickness / size, young * thickness * width**3 / 12 / size**3
        local = np.zeros((6, 6), complex)
        local[np.ix_([0, 3], [0, 3])] = ea * np.array([[1, -1], [-1, 1]])
        local[np.ix_([1, 2, 4, 5], [1, 2, 4, 5])] = ei * np.array(
            [
                [12, 6 * size, -12, 6 * size],
                [6 * size, 4 * size**2, -6 * size, 2 * size**2],
                [-12, -6 * size, 12, -6 * size],
                [6 * size, 2 * size**2, -6 * size, 4 * size**2],
            ]
        )
        turn = np.kron(np.eye(2), np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]]))
        stiffness[3 * k : 3 * k + 6, 3 * k : 3 * k + 6] += turn.T @ local @ turn
    inner, end = slice(3, -3), slice(-3, -1)
    own, cross = stiffness[end, end], stiffness[inner, end]
    return own - cross.T @ np.linalg.solve(stiffness[inner, inner], cross) if len(points) > 2 else own


def film(length, width, gap, omega, pressure, viscosity, cells):
    """Complex stiffness of a squeezed film, by differences of the linearised Reynolds equation."""
    s = 12j * viscosity * omega / (pressure * gap**2)

    def second(size):
        step = size / cells
        inner = cells - 1
        return (
            diags([np.full(inner - 1, 1.0), np.full(inner, -2.0), np.full(inner - 1, 1.0)], offsets=[-1, 0, 1])
            / step**2
        )

    laplace = kron(second(length), eye(cells - 1)) + kron(eye(cells - 1), second(width))
    p = spsolve((laplace - s * eye((cells - 1) ** 2)).tocsc(), np.full((cells - 1) ** 2, s / gap))
    return -pressure * p.sum() * length * width / cells**2
