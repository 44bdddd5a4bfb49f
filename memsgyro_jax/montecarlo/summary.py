"""The figures of a lot that a person and a script want: percentiles, yield, ratio to the bound."""

from dataclasses import asdict, astuple, dataclass

import numpy as np
from jaxtyping import Float
from scipy import stats

from memsgyro_jax.base.display import Shown
from memsgyro_jax.base.files import finite
from memsgyro_jax.base.provenance import Settings
from memsgyro_jax.base.text import aligned
from memsgyro_jax.loop.loop import ClosedLoop, claim_error
from memsgyro_jax.loop.observers import AbstractCovarianceObserver

from .divergence import NO_OBSERVER, Divergence
from .following import Following, following
from .merit import (
    Percentiles,
    Proportion,
    Ratio,
    StraightError,
    percentiles,
    proportion,
    ratio,
    straight_error,
)
from .tally import Tally
from .wording import (
    following_entries,
    following_text,
    lost_text,
    reached_text,
    sound_text,
    straight_entries,
    straight_name,
    straight_text,
    triple,
)


SCHEMA = "memsgyro-sweep/1"
_LIKELY = 0.99
_HIDDEN = 0.2  # share of the prior from which errors about one rate fall a tenth below the bound
_WIDE = 0.9  # of the bound, below which errors are told to be small for it
_MATTERS = 0.05  # share by which a mean NEES must exceed its interval to be remarked: linearising costs some percent
_CLAIMS_MATTER = 0.01  # share of its claims that coarse steps of a filter must cost for a remedy to be named


@dataclass(frozen=True)
class Summary(Shown):
    """Figures of a lot, in SI; `as_dict` gives the machine-readable form with its units in the names.

    Of `dies`, `redrawn` were drawn again because no device could be as they were drawn first. `end` and `settled` are
    over the dies that were not lost, `sound` over those that did not diverge either; `failed` dies were lost,
    `divergence` tells which of the others' filters were. `bound` is the root mean square over dies of the least
    standard deviation any unbiased use of the same data and prior could reach at the end, `reached` compares each die's
    error with its own bound, `reached_sound` without the diverged dies; all are None without a bound. `prior_share` is
    the part of the information in the bound that the filter's prior of the rate brought along. `nees` is the mean over
    dies, `nees_median` their median, `states` the expectation of the mean; `claim` the root mean square of the rate's
    error at the end over the standard deviation that is claimed of it; `straight` holds bias and scale-factor error,
    where the rate `moves` the mean error alone, in which the lag is. `lost_at` are the first, median and last time [s]
    at which a die was lost, beyond its `travel` [m] or not finite, `unbounded` says why there is no bound, `unsettled`
    how errors still move when the runs end, so that the yield is of a start, and `starting` how many dies that makes
    the scatter within one run of a start; `convergence_time` is None where the median die does not converge; `crossing`
    that of `crossed` dies the modes stand the other way round. `notes` were told before the run, `amiss` is what is
    wrong with its store. `steps_per_s` is None when a single batch left nothing to time after compiling.
    """

    dies: int
    redrawn: int
    failed: int
    end: Percentiles
    settled: Percentiles
    series_std: float
    sound: Percentiles
    divergence: Divergence
    bound: float | None
    prior_share: float | None
    reached: Ratio | None
    reached_sound: Ratio | None
    nees: float | None
    nees_median: float | None
    states: int | None
    nis: float | None
    claim: float | None
    convergence_time: float | None
    good: Proportion
    unsettled: str | None
    starting: str | None
    crossed: int
    crossing: str | None
    following: Following | None
    straight: StraightError | None
    moves: bool
    lost_at: tuple[float, float, float] | None
    unbounded: str | None
    claim_error: float | None
    notes: tuple[str, ...]
    amiss: tuple[str, ...]
    steps_per_s: float | None
    settings: Settings
    travel: float | None = None

    @property
    def nees_interval(self) -> tuple[float, float]:
        """Where the mean NEES of as many dies lies with a probability of 99 % if the filter is right."""
        assert self.states is not None
        count = self.dies - self.failed
        low, high = stats.chi2.interval(_LIKELY, self.states * count)
        return float(low) / count, float(high) / count

    @property
    def all_lost(self) -> bool:
        """Whether no die is left to speak of."""
        return 0 < self.failed == self.dies

    @property
    def ratio_to_bound(self) -> float | None:
        """Root mean square, over the dies, of error over that die's bound."""
        return None if self.reached is None else self.reached.value

    def as_dict(self) -> dict[str, object]:
        """The content of `summary.json`."""
        degrees = lambda p: {name: float(np.degrees(value)) for name, value in asdict(p).items()}  # noqa: E731
        entries = {
            "schema": SCHEMA,
            "dies": self.dies,
            "redrawn": self.redrawn,
            "failed": self.failed,
            "lost_at_s": self.lost_at,
            "diverged": {"count": len(self.divergence.dies), **asdict(self.divergence)},
            "rate_error_dps": {
                "end": degrees(self.end),
                "settled": degrees(self.settled),
                "end_without_diverged": degrees(self.sound),
            },
            "rate_series_std_dps": float(np.degrees(self.series_std)),
            "bound_dps": None if self.bound is None else float(np.degrees(self.bound)),
            "prior_share": self.prior_share,
            "ratio_to_bound": self.ratio_to_bound,
            "ratio_to_own_bound": None if self.reached is None else self.reached._asdict(),
            "nees": self.nees,
            "nees_median": self.nees_median,
            "nees_expected": self.states,
            "nis": self.nis,
            "rate_error_over_claim": self.claim,
            "convergence_time_s": self.convergence_time,
            "yield": asdict(self.good),
            "unsettled": self.unsettled,
            "rate_series_unsettled": self.starting,
            "crossed": self.crossed,
            "following": None if self.following is None else following_entries(self.following),
            **({} if self.straight is None else straight_entries(self.straight, self.moves)),
            "claim_error": self.claim_error,
            "notes": [*self.notes, *self.amiss],
            "steps_per_s": self.steps_per_s,
            "seed": self.settings.seed,
            "sample_rate_hz": self.settings.sample_rate,
            "duration_s": self.settings.duration,
            "fingerprint": self.settings.fingerprint,
            "versions": dict(self.settings.versions),
        }
        return finite(entries)

    def rows(self, notes: bool = True) -> list[tuple[str, str]]:
        """Name and value as text, for a table; without the `notes` where they have just been told."""
        diverged = len(self.divergence.dies)
        unknown = self.divergence.unjudged
        watched = unknown != NO_OBSERVER
        rows = [
            ("dies", f"{self.dies}, of which {self.failed} lost" + ("" if unknown else f", {diverged} diverged")),
            *([("  drawn again, impossible at first", self._redrawn())] if self.redrawn else []),
            *([("  lost at (first, median, last)", lost_text(at, self.travel))] if (at := self.lost_at) else []),
            *([("diverged dies", f"unknown, because {unknown}")] if unknown and watched else []),
            *(("  diverged, likely because", cause) for cause in self.divergence.causes),
            *([("rate error", "none, as every die was lost")] if self.all_lost else self._errors()),
        ]
        if self.bound is not None and self.reached is not None:
            rows.append(("information bound at the end (rms)", f"{np.degrees(self.bound):.3g} deg/s"))
            rows += [("  mostly known before", self.hidden)] if self.hidden else []
            rows.append(("error over own bound, die by die", reached_text(self.reached, self.dies)))
            rows += [("  less than the bound", self.wide)] if self.wide else []
            if diverged and self.reached_sound is not None:
                rows.append(("  without the diverged dies", reached_text(self.reached_sound, self.dies)))
        rows += [("information bound", self.unbounded)] if self.unbounded else []
        if watched and not self.all_lost:
            rows.append(("consistency (NEES, NIS)", self._consistency()))
            rows += [("  rate error over its claim (rms)", f"{self.claim:.3g} of 1")] if self.claim is not None else []
        if not self.all_lost:
            rows.append(("median time to converge", self._converged()))
        share = "{:.1f} % ({:.1f} to {:.1f} %)".format(*(100.0 * v for v in astuple(self.good)[:3]))
        trusted = "" if self.unsettled is None else "; not to be trusted"
        rows.append(("yield (95 % interval)", f"{share}: {self.good.criterion}{trusted}"))
        rows += [("  not settled", self.unsettled)] if self.unsettled else []
        rows += [("modes crossed", self.crossing)] if self.crossing else []
        if self.straight is not None:
            rows.append((straight_name(self.moves), straight_text(self.straight, self.moves)))
        if self.following is not None:
            rows.append(("varying rate followed", following_text(self.following, self.settings.duration)))
        rows += [("note", note) for note in (*(self.notes if notes else ()), *self.amiss)]
        if self.steps_per_s is not None:
            rows.append(("speed after compiling", f"{self.steps_per_s / 1e6:.3g} million steps/s"))
        return rows

    def _errors(self) -> list[tuple[str, str]]:
        """Of the dies that were not lost."""
        sound = [("  without the diverged dies", sound_text(self.sound))] if self.divergence.dies else []
        return [
            ("rate error at the end (rms, median, 95 %)", triple(self.end)),
            *sound,
            ("rate error over the settled part", triple(self.settled)),
            ("standard deviation within one run", self._scatter()),
            *([("  of the start", self.starting)] if self.starting else []),
        ]

    @property
    def hidden(self) -> str | None:
        """A sentence where the read-out says so little of the rate that the errors tell of the prior instead."""
        if self.prior_share is None or self.prior_share < _HIDDEN:
            return None
        return (
            f"{100.0 * self.prior_share:.0f} % of what can be known of the rate is the filter's prior, because the "
            "read-out's noise hides it; swing wider, run longer or lower the noise"
        )

    @property
    def wide(self) -> str | None:
        """A sentence where errors are smaller than what the bound allows and the filter claims; else None."""
        if self.reached is None or self.claim is None or self.hidden or max(self.reached.high, self.claim) > _WIDE:
            return None
        return (
            "the bound counts on dies as different as the filter's prior says; those of this lot likely differ less, "
            "for what the filter claims is too wide as well"
        )

    def _converged(self) -> str:
        if self.convergence_time is None:
            return "none: the median die has not converged within the run"
        within = "not shown: the median die is within the tolerance from the start"
        return f"{1e3 * self.convergence_time:.3g} ms" if self.convergence_time else within

    def _scatter(self) -> str:
        told = "unknown (the settled part holds one estimate)"
        return told if np.isnan(self.series_std) else f"{np.degrees(self.series_std):.3g} deg/s"

    def _redrawn(self) -> str:
        share = 100.0 * self.redrawn / self.dies
        return f"{self.redrawn} of {self.dies} dies ({share:.2g} %): the spread is cut where no device can be"

    def _consistency(self) -> str:
        nis = "NIS unknown (the observer claims no innovations)" if self.nis is None else f"NIS {self.nis:.3g} of 2"
        if self.nees is not None and self.nees_median is not None and self.states is not None:
            middle = f"median {self.nees_median:.3g} of {stats.chi2.median(self.states):.3g}"
            low, high = self.nees_interval
            # A filter that claims too much is careful, as annealing means it to be.
            remark = ": the filter claims too little error" if self.nees > (1.0 + _MATTERS) * high else ""
            # Many dies make it narrow: as many digits as tell its ends apart.
            digits = max(3, int(np.ceil(np.log10(20.0 * high / (high - low))))) if high > low else 3
            interval = f"99 %: {low:.{digits}g} to {high:.{digits}g}{remark}"
            return f"NEES {self.nees:.{digits}g} of {self.states} ({interval}; {middle}), {nis}{self._claims()}"
        if self.states is None:
            return f"NEES unknown (the observer claims no covariance), {nis}"
        return f"NEES unknown (the claimed covariance is singular: something is known exactly, or to rounding), {nis}"

    def _claims(self) -> str:
        """What the filter's own steps do to what it claims, where it is more than a rounded figure shows."""
        if self.claim_error is None or self.claim_error < 1e-3:
            return ""
        remedy = ", more nodes make them exact" if self.claim_error > _CLAIMS_MATTER else ""
        return f"; claims to {100.0 * self.claim_error:.1g} %{remedy}"

    def __repr__(self) -> str:
        return aligned(self.rows())


def figures_of(
    tally: Tally,
    settings: Settings,
    loop: ClosedLoop,
    bounds: Float[np.ndarray, " dies"] | None,
    unbounded: str | None,
    divergence: Divergence,
    notes: tuple[str, ...],
    amiss: tuple[str, ...],
    speed: float | None,
) -> Summary:
    """The summary of the dies in `tally`; lost ones count as failed and never as numbers. `bounds` are those of the
    first dies; without any, `unbounded` may say why.
    """
    plan, moves = tally.plan, tally.over_time is not None
    bounded = bounds is not None and bool(np.isfinite(bounds).any())
    bound = percentiles(bounds).rms if bounded else None
    reached, reached_sound = (
        (ratio(errors[: len(bounds)], bounds) for errors in tally.first) if bounded else (None, None)
    )
    over_time, (converged,) = tally.over_time, tally.converged.quantile(0.5)
    series = np.sqrt(tally.series_squares / tally.series_count) if tally.series_count else np.nan
    within = f"rate error at the end within {np.degrees(plan.tolerance):.3g} deg/s"
    return Summary(
        dies=tally.computed,
        redrawn=tally.redrawn,
        failed=tally.lost,
        end=tally.end.percentiles,
        settled=tally.run.percentiles,
        series_std=float(series),
        sound=tally.sound.percentiles,
        divergence=divergence,
        bound=bound,
        prior_share=None if bound is None else _prior_share(loop, bound),
        reached=reached,
        reached_sound=reached_sound,
        nees=tally.mean("nees_end"),
        nees_median=None if tally.mean("nees_end") is None else tally.nees.quantile(0.5)[0],
        states=_states(loop),
        nis=tally.mean("nis_mean"),
        claim=None if (square := tally.mean("claim")) is None else float(np.sqrt(square)),
        convergence_time=converged if np.isfinite(converged) else None,
        good=proportion(tally.good, tally.computed, within),
        unsettled=tally.movement.sentence(loop),
        starting=None if loop.observer.learns else tally.scatter.sentence(loop),
        crossed=tally.crossed,
        crossing=tally.crossing,
        following=None if over_time is None else following(plan.window_times, *over_time, plan.settle),
        straight=straight_error(tally.straight, moves),
        moves=moves,
        lost_at=tally.lost_at,
        unbounded=unbounded if bound is None else None,
        claim_error=claim_error(loop, settings.sample_rate),
        notes=notes,
        amiss=amiss,
        steps_per_s=speed,
        settings=settings,
        travel=float(np.max(np.asarray(loop.travel))),
    )


def _prior_share(loop: ClosedLoop, bound: float) -> float | None:
    if not isinstance(loop.observer, AbstractCovarianceObserver):
        return None
    std = float(np.max(np.asarray(loop.observer.prior.theta_std[loop.observer.model.index("rate")])))
    return (bound / std) ** 2 if std > 0.0 else None


def _states(loop: ClosedLoop) -> int | None:
    return len(loop.observer.states) if isinstance(loop.observer, AbstractCovarianceObserver) else None
