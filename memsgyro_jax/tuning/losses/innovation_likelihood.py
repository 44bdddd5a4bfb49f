"""Negative log-likelihood of what was measured, by the filter's own claims."""

from typing import ClassVar

from .base import AbstractMean, innovation_of


class InnovationLikelihood(AbstractMean):
    """Mean over samples from `settle` [s] on of ½ Σ (ln S + e²/S) over both channels, in nats (prediction error
    decomposition, Schweppe, IEEE Trans. Inf. Theory 11, 1965).

    e is the innovation in V and S the variance in V² that the filter claims for it. It needs no truth, so it works on
    recorded voltages too, and it fixes the scale of the noises that a squared error leaves open. It does not see what
    comes behind the filter. A constant, ln 2π, is left out.
    """

    sees_truth: ClassVar[bool] = False

    def of(self, sample):
        return innovation_of(sample, "InnovationLikelihood").nats
