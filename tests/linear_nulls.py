"""What a diagnosis decides in its first round where nothing is missing, for many draws of noise.

Beside the truth a model is linear in noise: sensitivities are computed once for a case, and each draw is decided by the
package's own tests. Where the noise is not declared, it is estimated from the rows of the draw.
"""

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from bench_case import truth
from lab.die import Hidden

from memsgyro_jax.diagnosis.acceptance import judged_by_misfit, refusal, unsure_noise
from memsgyro_jax.diagnosis.diagnose import RECORDS
from memsgyro_jax.diagnosis.fewer import SHARE
from memsgyro_jax.diagnosis.fit import beside_case
from memsgyro_jax.diagnosis.fitted import FITTED
from memsgyro_jax.diagnosis.instrument import instrument_terms, knowledge
from memsgyro_jax.diagnosis.joint_residual import Joint
from memsgyro_jax.diagnosis.optimum import Optimum
from memsgyro_jax.diagnosis.score import basis, best_by_noise, family_p_values, score, within_bounds
from memsgyro_jax.diagnosis.search import Ranking, Search
from memsgyro_jax.diagnosis.slow_noise import slow_noise
from memsgyro_jax.effects import Scanned, catalogue
from memsgyro_jax.measurement.least_squares import above, gate
from memsgyro_jax.measurement.readings import readings_of


LEVEL = 0.05


class Decision(NamedTuple):
    """What is reported of a draw: an effect, a record that nothing explains, a term of the instrument, noise that is
    slow; whether an effect was tempting; the smallest p-value of all effects together.
    """

    effect: bool
    record: bool
    term: bool
    slow: bool
    tempted: bool
    p_value: float

    @property
    def alarm(self):
        return self.effect or self.record or self.term or self.slow


class LinearJoint(Joint):
    """A joint residual that is linear: values and slopes at its start, of all readings in their order."""

    def __init__(self, joint, every, value, slopes):
        super().__init__(joint.model, joint.readings, joint.programs)
        ends = np.cumsum([r.size for r in every])[:-1]
        self.parts = {
            id(r): part for r, *part in zip(every, np.split(value, ends), np.split(slopes, ends), strict=True)
        }

    def residual(self, vector, chosen):
        return [value + slopes @ (vector - self.start) for value, slopes in (self.parts[id(r)] for r in chosen)]

    def linearise(self, vector, directions, chosen):
        slopes = np.concatenate([self.parts[id(r)][1] for r in chosen])
        return np.concatenate(self.residual(vector, chosen)), slopes @ directions.T


@dataclass(frozen=True, eq=False)
class Nulls:
    """A case of which the truth is known, as vectors. `slopes` are by all parameters of `joint` (r, p), fitted numbers
    first; `terms` are those of the instrument's terms, with what is known of them below the fitted numbers.
    """

    case: object
    clean: dict
    joint: Joint
    every: tuple
    slopes: np.ndarray
    terms: tuple
    bounds: tuple
    families: dict = field(default_factory=dict)

    @classmethod
    def of(cls, made, case):
        effects = [e for e in catalogue(made.die.axes) if not isinstance(e, Scanned)]
        plain = truth(case, made.die, Hidden(), ())
        joint = Joint(plain.with_effect(*effects), readings_of(case))
        every = (*joint.fitted, *(r for r in joint.readings if not r.fitted))
        slopes = joint.linearise(joint.start, np.eye(joint.start.size), every)[1]
        kinds = instrument_terms(case)
        beside = Joint(plain.with_effect(*kinds), (*joint.readings, *knowledge(kinds)))
        by_term = beside.linearise(beside.start, np.eye(beside.start.size), beside.fitted)[1]
        blocks = [beside.of_effect(i) for i in range(len(kinds))]
        low, high = beside.bounds
        return cls(
            case, {name: record.clean for name, record in made.records.items()}, joint, every,
            np.where(np.isfinite(slopes), slopes, 0.0), tuple(by_term[:, block] for block in blocks),
            tuple((low[block], high[block]) for block in blocks),
        )  # fmt: skip

    @cached_property
    def record(self):
        """Of each number of the residual; −1 is padding."""
        return np.concatenate([np.repeat(r.record, r.size // r.record.size) for r in self.every])

    @cached_property
    def undeclared(self):
        """The same case, without a word on noise."""
        return replace(self.case, records=tuple(replace(r, noise_std=None) for r in self.case.records))

    @property
    def vectors(self):
        """Labels of the effects, a basis of what is free, and the sensitivities to each effect, of what is fitted."""
        joint, slopes = self.joint, self.slopes[: self.fitted]
        effects = joint.model.effects
        parts = tuple(slopes[:, joint.of_effect(i)] for i in range(len(effects)))
        return tuple(e.label for e in effects), basis(slopes[:, joint.base()]), parts

    @property
    def fitted(self):
        """How many numbers are fitted."""
        return sum(r.size for r in self.joint.fitted)

    def noise(self, rng):
        """Whitened by the true noise; nothing in padding."""
        return np.where(self.record >= 0, rng.standard_normal(self.record.size), 0.0)

    def estimated(self, noise):
        """The true noise of each number over the one that the rows of the draw tell."""
        factor = np.ones(noise.size)
        for number, record in enumerate(self.case.records):
            shape = (*record.readings.shape, 2 if np.iscomplexobj(record.readings) else 1)
            white, begin = np.zeros(shape), 0
            for r in self.every:
                mine, part = r.record == number, noise[begin : begin + r.size]
                if mine.any():
                    white[r.row[mine]] = part.reshape(r.record.size, *shape[1:])[mine]
                begin += r.size
            drawn = record.noise_std * (white[..., 0] + 1j * white[..., 1] if shape[-1] == 2 else white[..., 0])
            field = "phasors" if shape[-1] == 2 else "signals"
            read = replace(record, noise_std=None, **{field: self.clean[record.name] + drawn})
            factor[self.record == number] = record.noise_std / read.estimated_noise()
        return factor

    def decide(self, noise, factor=None):
        """Of a draw, with the true noise declared, or believed to be 1/`factor` of it as its rows told."""
        case = self.case if factor is None else self.undeclared
        freedom = [record.noise_freedom for record in case.records]
        unsure = unsure_noise(case, self.joint.fitted)
        factor = 1.0 if factor is None else factor
        fitted = slice(self.fitted)
        value, slopes = noise * factor, self.slopes * np.reshape(factor * np.ones(noise.size), (-1, 1))
        joint, base = self.joint, self.joint.base()
        before = _fitted(joint, base, value[fitted], slopes[fitted])
        within, p_records = self._records(before, value, slopes, freedom)
        blocks = [joint.of_effect(i) for i in range(len(joint.model.effects))]
        candidates = [slopes[fitted][:, block] for block in blocks]
        p_values, found = self._ranked(before, candidates, [_part(joint, block) for block in blocks], unsure)
        ranking = Ranking(tuple(range(len(found))), tuple(found), p_values, tuple(candidates))
        if self._slow(case, before, value, slopes, ranking):
            return Decision(False, False, False, True, False, float(p_values.min()))
        best = int(np.argmin([s.p_value for s in found]))
        tempted = p_values[best] <= LEVEL
        effect = False
        if tempted:
            after = _fitted(joint, np.append(base, blocks[best]), value[fitted], slopes[fitted])
            effect = not refusal(joint, best, before, after, others=0, case=case)
        tried = tempted or not all(within)
        term = tried and self._ranked_terms(before, unsure) <= SHARE * LEVEL
        return Decision(
            effect, min(p_records) <= RECORDS * LEVEL / len(p_records), term, False, tempted, float(p_values.min())
        )

    def _slow(self, case, before, value, slopes, ranking):
        """Whether the noise is called slow, which ends a diagnosis."""
        joint = LinearJoint(self.joint, self.every, value, slopes)
        search = Search(beside_case(case, joint, before), LEVEL, (), lambda text: None)
        return bool(slow_noise(search, ranking))

    def _ranked(self, before, slopes, bounds, unsure):
        q, residual = basis(before.jacobian), before.residual
        found = [within_bounds(score(residual, q, s), residual, s, *b) for s, b in zip(slopes, bounds, strict=True)]
        found = [replace(s, p_value=judged_by_misfit(s, before.chi2, before.dof, unsure)) for s in found]
        if len(found) not in self.families:  # directions hardly depend on the draw: one simulation will do
            self.families[len(found)] = best_by_noise([s for s in found if s.size])
        return family_p_values(found, best=self.families[len(found)]), found

    def _ranked_terms(self, before, unsure):
        rows = self.terms[0].shape[0] - self.fitted
        widened = replace(
            before, residual=np.append(before.residual, np.zeros(rows)),
            jacobian=np.concatenate([before.jacobian, np.zeros((rows, before.jacobian.shape[1]))]),
        )  # fmt: skip
        return float(self._ranked(widened, self.terms, self.bounds, np.append(unsure, np.zeros(rows)))[0].min())

    def _records(self, before, value, slopes, freedom):
        """Per record and role whether it is within its gate, and the p-value of more."""
        base, moved = before.free, before.vector[before.free] - self.joint.start[before.free]
        left = value + slopes[:, base] @ moved
        role = np.arange(value.size) < self.fitted
        root = np.linalg.qr(before.jacobian, mode="r")
        within, p_values = [], []
        for number in range(len(self.case.records)):
            for fit in (True, False):
                mine = (self.record == number) & (role == fit)
                if not mine.any():
                    continue
                chi2, count = float(left[mine] @ left[mine]), int(mine.sum())
                within.append(chi2 / count <= gate(count, freedom=freedom[number]))
                if not fit:
                    through = np.linalg.lstsq(root.T, slopes[mine][:, base].T)[0]
                    inner = through @ left[mine]
                    chi2 -= float(inner @ np.linalg.solve(np.eye(len(inner)) + through @ through.T, inner))
                fine = fit and chi2 / count <= gate(count, FITTED, freedom[number])
                p_values.append(1.0 if fine else above(chi2, count, freedom[number]))
        return within, p_values


def _part(joint, block):
    return tuple(bound[block] for bound in joint.bounds)


def _fitted(joint, places, value, slopes):
    """The optimum of a linear model."""
    jacobian = slopes[:, places]
    size = np.linalg.norm(jacobian, axis=0)
    step = -np.linalg.lstsq(jacobian / np.where(size > 0, size, 1.0), value)[0] / np.where(size > 0, size, 1.0)
    vector = joint.start.copy()
    vector[places] += step
    return Optimum(vector, places, value + jacobian @ step, jacobian, np.zeros((0, places.size)), True, 1)
