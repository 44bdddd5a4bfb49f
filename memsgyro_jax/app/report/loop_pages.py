"""The pages of `memsgyro loop`, a loop over frequency, and of `memsgyro tornado`, what each parameter changes."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from memsgyro_jax.montecarlo.sensitivity.tornado import HEAD as TORNADO_HEAD

from .figures import blank, plain
from .page import Page
from .sweep_page import with_settings


if TYPE_CHECKING:
    from memsgyro_jax.loop.frequency_response import FrequencyResponse
    from memsgyro_jax.loop.gain_phase import GainPhaseMargins
    from memsgyro_jax.loop.noise_budget import NoiseBudget
    from memsgyro_jax.montecarlo.sensitivity import Tornado

    from ..study import Study


def loop_page(
    study: "Study", answers: "Sequence[FrequencyResponse]", margins: "GainPhaseMargins | None", noise: "NoiseBudget"
) -> Page:
    """The page of the loop of `study`: a Bode diagram of each of the `answers`, its margins if any, and noise."""
    page = Page("A loop over frequency", f"{study.source.name}, at its design")
    for answer in answers:
        page.section(f"From {answer.disturbed} to the rate given out").text(f"{answer.headline}.")
        for note in answer.notes:
            page.text(f"{note[0].upper()}{note[1:]}.")
        if not np.all(np.isfinite(answer.response)):
            continue
        figure = blank(3.6)
        answer.plot(figure.subplots())
        page.figure(figure, "Gain and, dashed, phase of the rate given out over that of a small sine.")
    if margins is not None:
        from memsgyro_jax.loop.gain_phase import HEAD

        page.section("Margins of its loops").table(HEAD, margins.rows(), stacked=True)
        for note in margins.notes:
            page.text(note)
    page.section("Noise of the rate by source")
    page.text(f"{str(noise).splitlines()[0]}.")
    figure = blank(3.4)
    noise.plot(figure.subplots())
    page.figure(plain(figure), "Powers of the sources, one on another, over the frequency of the rate.")
    for note in noise.notes:
        page.text(note)
    page.section("Settings")
    unused = "tune.", "spread.", "scenario.", "sweep.dies", "sweep.tolerance", "sweep.chunk", "sweep.seed"
    return with_settings(page, study, None, *unused)


def tornado_page(bars: "Tornado", study: "Study") -> Page:
    """The page of a tornado of the spread of `study`: of each output that moves its bars and their table."""
    page = Page("What each parameter changes", f"{study.source.name}: {bars.status}")
    for note in bars.notes:
        page.text(note)
    for k, name in enumerate(bars.outputs):
        design = f"{bars.design[k]:.4g} {bars.units[k]}"
        page.section(name[0].upper() + name[1:])
        if not bars.moved(k):
            page.text(f"{design}, whatever parameter moves.")
            continue
        figure = blank(1.4 + 0.36 * len(bars.inputs))
        bars.plot(figure.subplots(), name)
        page.text(f"{design} {bars.where}.").figure(
            plain(figure), f"Change by ∓{bars.sigmas:g} σ of one parameter alone, the largest on top."
        )
        page.table(TORNADO_HEAD, bars.rows(k))
        if note := bars.note(k):
            page.text(note)
    page.section("Settings")
    return with_settings(page, study, bars.settings, "tune.", "sweep.dies", "sweep.chunk")
