"""Fits that are far off, made again from where drives or surroundings, one after the other, put them."""

from dataclasses import replace

from memsgyro_jax.measurement.case import Case

from .drives import FAR, past_the_brink, stages, up
from .joint_residual import Joint
from .optimum import Optimum, optimise
from .settings_apart import in_each_place, moves, put_beside


FURTHER = 4  # times that a fit goes on


def in_its_valley(case: Case, joint: Joint, optimum: Optimum) -> Optimum:
    """A fit, and where it is far off the better one of those that begin where each of the surroundings by itself puts
    it, or that follow the device from its lowest drive to its highest.
    """
    if optimum.chi2 <= FAR * optimum.dof:
        return to_its_end(joint, optimum)
    ends, places = [optimum], optimum.free
    if moves(every := in_each_place(case)):
        vector = joint.start.copy()
        vector[places] = put_beside(joint, every, range(len(joint.model.effects)))[places]
        ends.append(optimise(joint, vector, places, joint.fitted))
    if min(end.chi2 for end in ends) > FAR * optimum.dof and len(steps := stages(case, joint.fitted)) > 1:
        ends.append(up(joint, joint.start, places, steps))
    return to_its_end(joint, past_the_brink(case, joint, min(ends, key=lambda end: end.chi2)))


def to_its_end(joint: Joint, optimum: Optimum) -> Optimum:
    """A fit that goes on where it has not converged and still gets better."""
    for _ in range(FURTHER):
        if optimum.converged:
            break
        more = optimise(joint, optimum.vector, optimum.free, joint.fitted)
        if more.chi2 >= optimum.chi2:
            break
        optimum = replace(more, evaluations=optimum.evaluations + more.evaluations)
    return optimum
