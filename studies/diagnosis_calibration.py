"""How often is a diagnosis right? False alarms, power and strangers on four devices far from the thesis'.

The devices, their benches and what hides in them come from the independent laboratory of the tests. Three questions:

- *Nothing is missing.* Beside the truth a model is linear in noise, so sensitivities are computed once and each of many
  draws of noise is decided by the package's own tests: scores of all effects together, the gates of every record, terms
  of the instrument; with the noise declared, and with the noise estimated from the rows of the draw.
- *A known effect is missing*, at six standard deviations: does it, or one that these records cannot tell from it, come
  first?
- *A stranger*: physics or a fault that no catalogue lists. It must never be called found, by more than two effects, or
  with a sign that physics excludes. Whole diagnoses, as well as some of sound devices: `--dies` of each.
"""

import json
import multiprocessing
import sys
import tempfile
from collections import Counter
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path

import numpy as np
from _common import Report
from scipy import stats


sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

from lab.devices import DEVICES
from lab.die import Hidden
from lab.laboratory import make_case
from lab.strangers import strangers

from memsgyro_jax.base import runtime


LEVEL, STRONG, QUICK = 0.05, 6.0, "one axis, 32.8 kHz, Q 20 000"


def main() -> None:
    numbers = {
        "nulls": (2000, "draws of noise per device"),
        "dies": (1, "whole diagnoses of each stranger and each sound device, which take minutes"),
        "processes": (1, "that diagnose side by side"),
    }
    report = Report(numbers=numbers)
    runtime.configure()
    nulls = 60 if report.quick else report.numbers["nulls"]
    for name in [QUICK] if report.quick else DEVICES:
        linearised(report, name, nulls)
    if not report.quick and report.numbers["dies"]:
        whole(report, report.numbers["dies"], report.numbers["processes"])
    report.finish()


def interval(count: int, of: int) -> str:
    """Share with its 95 % interval (Clopper and Pearson)."""
    low, high = stats.binomtest(count, of).proportion_ci(0.95)
    return f"{100 * count / of:.3g} % ({100 * low:.1f} to {100 * high:.1f})"


# ---- where everything is linear


def linearised(report: Report, name: str, count: int) -> None:
    from linear_nulls import Nulls
    from power import Linear

    from memsgyro_jax.measurement.case import load_case

    device = DEVICES[name]
    with tempfile.TemporaryDirectory() as folder:
        made = make_case(Path(folder) / "case", device.die, Hidden(), 0, device.protocol)
        nulls = Nulls.of(made, load_case(made.folder))
    for declared in (True, False):
        rng = np.random.default_rng(7)
        draws = [nulls.noise(rng) for _ in range(count)]
        done = [nulls.decide(z, None if declared else nulls.estimated(z)) for z in draws]
        alarms = sum(one.alarm for one in done)
        why = ", ".join(f"{kind} {sum(getattr(one, kind) for one in done)}" for kind in ("effect", "record", "term"))
        noise = "declared" if declared else "estimated"
        report.row(
            f"{name}: false alarms, noise {noise}", f"{100 * LEVEL:g} %", interval(alarms, count), f"{why} of {count}"
        )
    linear, rng = Linear(*nulls.vectors), np.random.default_rng(8)
    shown = [place for place, one in enumerate(linear.scores) if one.size]
    shares = {linear.labels[place]: first_share(linear, place, count, rng) for place in shown}
    worst = min(shares, key=lambda label: shares[label])
    report.row(
        f"{name}: right effect or group first, at {STRONG:g} sigma", ">= 95 %",
        f"{100 * np.mean(list(shares.values())):.1f} %",
        f"{len(shares)} effects, {count} draws each; the worst: {worst} {100 * shares[worst]:.1f} %",
    )  # fmt: skip


def first_share(linear, place: int, count: int, rng) -> float:
    from memsgyro_jax.diagnosis.search import CONFUSED

    alike = linear.group(place, 1.0 - CONFUSED / STRONG**2)
    residuals = linear.noise(count, rng) + linear.shown(place, STRONG)
    return float(np.mean(np.isin(np.argmin(linear.single(residuals), axis=1), alike)))


# ---- whole diagnoses


def whole(report: Report, dies: int, processes: int) -> None:
    jobs = [
        (device, kind, seed) for seed in range(dies) for device in DEVICES for kind in ("", *strangers(DEVICES[device]))
    ]
    path, found = report.folder / "diagnoses.jsonl", []
    with (
        ProcessPoolExecutor(processes, mp_context=multiprocessing.get_context("spawn")) as pool,
        path.open("w") as file,
    ):
        for job in as_completed([pool.submit(diagnosed, *job) for job in jobs]):
            found.append(job.result())
            file.write(json.dumps(found[-1]) + "\n")
            file.flush()
    for name in DEVICES:
        sound = [one for one in found if one["device"] == name and not one["stranger"]]
        alarms = sum(one["verdict"] != "nothing_missing" for one in sound)
        report.row(
            f"{name}: whole diagnoses that alarm",
            f"{100 * LEVEL:g} %",
            interval(alarms, len(sound)),
            f"of {len(sound)}",
        )
        odd = [one for one in found if one["device"] == name and one["stranger"]]
        right = sum(one["right"] for one in odd)
        verdicts = ", ".join(f"{verdict} {n}" for verdict, n in Counter(one["verdict"] for one in odd).items())
        report.row(f"{name}: strangers that stay strangers", ">= 95 %", interval(right, len(odd)), verdicts)


def diagnosed(name: str, stranger: str, seed: int) -> dict:
    """One whole diagnosis; `right` where nothing is found, no more than two effects named, and no impossible sign."""
    runtime.configure()
    from memsgyro_jax.diagnosis.diagnose import diagnose
    from memsgyro_jax.effects import catalogue, free_numbers
    from memsgyro_jax.measurement.case import load_case

    device = DEVICES[name]
    hidden, bench = strangers(device)[stranger] if stranger else (Hidden(), device.protocol)
    with tempfile.TemporaryDirectory() as folder:
        made = make_case(Path(folder) / "case", device.die, hidden, seed, bench)
        outcome = diagnose(None, load_case(made.folder))
    ranges = {
        e.label: (n.low, n.high) for e in catalogue(device.die.axes) for n in free_numbers(e) if n.field == "strength"
    }
    possible = all(
        low <= value <= high for one in outcome.accepted for low, high in [ranges[one.label]] for value in one.estimate
    )
    named = [one.label for one in outcome.accepted] or [step.added for step in outcome.tried]
    return {
        "device": name, "stranger": stranger, "seed": seed, "verdict": outcome.verdict, "named": named,
        "instrument": [one.label for one in outcome.instrument], "sentence": outcome.sentence,
        "chi2_per_dof": [step.chi2_per_dof for step in outcome.steps],
        "right": outcome.verdict != "found" and len(named) <= 2 and possible,
    }  # fmt: skip


if __name__ == "__main__":
    main()
