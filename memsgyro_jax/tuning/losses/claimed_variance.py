"""The information about the rate, as a Kalman filter counts it."""

from typing import ClassVar

import jax.numpy as jnp

from .base import AbstractMean, claimed_variance


class ClaimedVariance(AbstractMean):
    """Mean from `settle` [s] on of ln of the variance of the rate, in (rad/s)², that the filter claims.

    With the true noises a filter that is consistent claims the Bayesian information bound, so this is the bound without
    a second computation: for tuning what makes the motion informative (auxiliary tones, reference frequencies). It
    believes any claim of the filter, whose own numbers tuning refuses to free with it. It needs no truth.
    """

    sees_truth: ClassVar[bool] = False
    believes_claims: ClassVar[bool] = True

    def of(self, sample):
        return jnp.log(claimed_variance(sample, "ClaimedVariance"))
