"""What the uncertainty of a fit moves in records that it has not seen: no failure of the model."""

from dataclasses import replace

import numpy as np
from scipy import special

from .fit import CaseFit, put_in_place


UNLIKELY = 0.01  # that the parameters of a right model are so far from their fit


def beside_uncertainty(fit: CaseFit) -> CaseFit:
    """The fit, what it has not seen moved as a refit with it would; the same where the fitted readings deny that.

    A record at a stronger drive than all that were fitted amplifies what they leave open.
    """
    joint, at = fit.joint, fit.optimum
    others = [r for r in joint.readings if not r.fitted]
    if not others or not at.free.size:
        return fit
    units = np.eye(at.vector.size)[at.free]
    parts = [joint.linearise(at.vector, units, [readings]) for readings in others]
    values, slopes = (np.concatenate(part) for part in zip(*parts, strict=True))
    known = np.isfinite(values) & np.isfinite(slopes).all(axis=1)
    root = np.linalg.qr(at.jacobian, mode="r")
    whole = np.concatenate([root, np.where(known[:, None], slopes, 0.0)])
    size = np.linalg.norm(whole, axis=0)
    size = np.where(size > 0, size, 1.0)
    target = np.concatenate([np.zeros(len(root)), np.where(known, values, 0.0)])
    shift = np.linalg.lstsq(whole / size, target)[0] / size
    if special.chdtrc(at.free.size, float(np.sum((root @ shift) ** 2))) < UNLIKELY:
        return fit
    moved = values - slopes @ shift
    white, seen = [part.copy() for part in fit.whitened], [part.copy() for part in fit.fitted]
    ends = np.cumsum([len(part[0]) for part in parts])
    for readings, rows in zip(others, np.split(moved, ends[:-1]), strict=True):
        put_in_place(readings, rows, white, seen)
    return replace(fit, whitened=tuple(white))
