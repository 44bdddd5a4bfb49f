"""The study file as a whole: its sections, the objects they describe, and writing it."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import jax
import jax.numpy as jnp
import numpy as np
from pydantic import ConfigDict, Field, model_validator

from memsgyro_jax.base.complaints import Misplaced, Source
from memsgyro_jax.base.display import Shown
from memsgyro_jax.base.errors import InputError
from memsgyro_jax.base.files import write_whole
from memsgyro_jax.base.quantity import FileSection, field_unit
from memsgyro_jax.base.toml import checked, toml_table, toml_text
from memsgyro_jax.device.gyro import AbstractGyro
from memsgyro_jax.device.propagate import Exact
from memsgyro_jax.effects import Effect
from memsgyro_jax.effects.section import EffectSection, unit_of_setting
from memsgyro_jax.loop.filters import check_fits
from memsgyro_jax.loop.loop import ClosedLoop
from memsgyro_jax.loop.scenario import Scenario
from memsgyro_jax.montecarlo.spread import Normal, Root, Spread, Vary
from memsgyro_jax.tuning.tunable import Tunable, free

from .classic import Unobserved
from .completed import USUAL_SPREAD, completed, left_to_device, rested
from .control import MEASURING, Actuators, Controller
from .hardware import Device, Readout, device_of, readout_of, unit_of_device
from .laws import Anneal, Kalman, Observer, discretisation
from .layout import DrawnComb, LayoutDevice, ProcessSection
from .masses import Fitted
from .numbers import entries_of, unit_at
from .output import Filter
from .paths import FOLDER
from .pickoffs import FittedReadout
from .plan import SpreadSection, Start, SweepSection
from .surroundings import Surroundings
from .thesis import DENSITY, thesis_device, thesis_readout
from .tuning import Tune


SCHEMA = "memsgyro-study/1"


class StudyFile(FileSection):
    """All sections. One that is left out is that of the default study; one that is given replaces it as a whole.

    Numbers that are None are left to the device; `completed` fills them in.
    """

    model_config = ConfigDict(validate_by_name=True, validate_by_alias=True)
    format: Literal["memsgyro-study/1"] = Field(default=SCHEMA, alias="schema")
    """Format of the file, and its version."""
    device: Device = Field(default_factory=thesis_device)
    """The gyro; left out, that of thesis Table 5.1."""
    process: ProcessSection | None = None
    """What the process makes of a device or a read-out of `kind = "layout"`; left out, the drawing."""
    effects: tuple[EffectSection, ...] = ()
    """Effects beyond the base device, each a table `[[effects]]`; left out, none."""
    readout: Readout = Field(default_factory=thesis_readout)
    """What turns motion into volts; left out, that of thesis Table 5.3, or of the fit that `[device]` names."""
    observer: Observer = Field(default_factory=lambda: Kalman(kind="ekf", annealing=Anneal()))
    """What estimates the rate; left out, "ekf" with a cautious start, "none" where the controller measures by
    itself."""
    controller: Controller | None = None
    """What drives the mass; left out, "damping_compensation" with a tone on both axes at a fifth of the lower mode."""
    actuators: Actuators | None = None
    """How large forces may be; left out, without a limit."""
    filter: Filter | None = None
    """What smooths the estimated rate into the output of the loop; left out, none."""
    loop: Start = Start()
    """Where the mass starts, how far it may travel, and how the device is computed."""
    scenario: Surroundings = Field(default_factory=lambda: Surroundings(rate="1 rad/s"))
    """What varies during a run; left out, a constant rate of 1 rad/s."""
    spread: SpreadSection = SpreadSection(relative=USUAL_SPREAD)
    """What differs from die to die; left out, every number of the device, by 15 %."""
    sweep: SweepSection = SweepSection()
    """How many dies, how long and how finely."""
    tune: Tune = Tune()
    """What `memsgyro tune` may move, and what it makes small."""

    @model_validator(mode="before")
    @classmethod
    def _who_measures_needs_no_observer(cls, data: Any) -> Any:
        """Some controllers measure by themselves, unless an observer is asked for."""
        kind = (data.get("controller") or {}).get("kind") if isinstance(data, dict) else None
        if kind in MEASURING and "observer" not in data:
            return {**data, "observer": {"kind": "none"}}
        return data

    @model_validator(mode="after")
    def _someone_measures(self) -> "StudyFile":
        if isinstance(self.observer, Unobserved) and getattr(self.controller, "kind", None) not in MEASURING:
            measuring = " or ".join(f'"{kind}"' for kind in MEASURING)
            wrong = f'must not be "none" with a controller that needs an estimate; use {measuring}'
            raise Misplaced(("observer", "kind"), ValueError(wrong))
        return self

    @model_validator(mode="after")
    def _something_is_made(self) -> "StudyFile":
        if (
            self.process is not None
            and not isinstance(self.device, LayoutDevice)
            and not isinstance(self.readout, DrawnComb)
        ):
            wrong = 'must make a device or a readout of kind = "layout", but neither is one'
            raise Misplaced(("process",), ValueError(wrong))
        return self

    @model_validator(mode="before")
    @classmethod
    def _readout_of_the_fit(cls, data: Any) -> Any:
        """A fitted device brings its read-out along, all but the noise."""
        if isinstance(data, dict) and "readout" not in data and "file" in (data.get("device") or ()):
            return {**data, "readout": {"kind": "fitted", "noise_density": DENSITY}}
        return data

    def unit_of(self, path: str) -> str | None:
        """The unit of a number of the loop or scenario, where the sections know it."""
        first, *rest = [part for part in path.split(".") if not part.isdigit() and part not in ("layout", "drawn")]
        if "process" in (first, *rest[:-1]):
            return field_unit(ProcessSection, rest[-1]) if rest else None
        if path == "device.cross_damping_asymmetry":
            return "N*s/m"
        if first == "start":
            return "m" if path in ("start.0", "start.1") else "m/s"
        if first in ("device", "readout", "filter") and len(rest) == 1 and getattr(self, first) is not None:
            section = getattr(self, first)
            return unit_of_device(section, rest[0]) if first == "device" else field_unit(type(section), rest[0])
        profiles = getattr(self.scenario, rest[0], ()) if first == "scenario" and rest else ()
        if isinstance(profiles, tuple) and len(profiles) == 1:
            return field_unit(type(profiles[0]), rest[-1])
        return None


def _given(part: Any) -> Any:
    """A series as chosen so far, for good."""
    return Exact(part.order, part.nodes) if isinstance(part, Exact) else part


@dataclass(frozen=True)
class Study(Shown):
    """A study as objects: what `simulate` and `sweep` take.

    `settings` holds dies, sample_rate [Hz], duration [s], settle [s], tolerance [rad/s], seed and chunk; `file` the
    form in which it is written, and `given` that without the numbers left to the device.
    """

    loop: ClosedLoop
    scenario: Scenario
    spread: Spread
    file: StudyFile
    given: StudyFile
    source: Source
    own: tuple[Effect, ...] = ()

    @property
    def notes(self) -> list[str]:
        """What a person should know of a device of its own: what is a fit's, and what follows the device."""
        about = left_to_device(self.given, self.file) if "device" in self.given.model_fields_set else []
        if not isinstance(self.file.device, Fitted):
            return about
        found = ["the device"]
        carried = self.loop.device.effects[: len(self.loop.device.effects) - len(self.file.effects)]
        found += [f"its effects ({', '.join(effect.label for effect in carried)})"] if carried else []
        found += ["scale and offset of the read-out"] if isinstance(self.file.readout, FittedReadout) else []
        return [f"{self.file.device.file} gives {', '.join(found)}; everything else is the study's.", *about]

    @property
    def settings(self) -> SweepSection:
        """Section `[sweep]`."""
        return self.file.sweep

    @property
    def tune_arguments(self) -> dict[str, Any]:
        """`tune(**study.tune_arguments)` tunes what section `[tune]` says."""
        run, section = self.settings, self.file.tune
        duration = self.sweep_arguments["duration"]
        settle = 0.5 * duration if run.settle is None else run.settle
        return {
            "loop": self.loop, "spread": self.spread, "scenario": self.scenario, "free": self._free(),
            "loss": section.chosen_loss(settle), "dies": section.dies, "validation_dies": section.validation_dies,
            "evaluations": section.evaluations, "report_dies": run.dies, "sample_rate": run.sample_rate,
            "duration": duration, "settle": settle, "seed": run.seed,
        }  # fmt: skip

    def _free(self) -> tuple[Tunable, ...]:
        names, section = self.loop.device.model.names, self.file.tune
        if section.free is None:
            observer = self.loop.observer.usually_tuned
            own = free(observer=observer) if observer else free(controller=self.loop.controller.usually_tuned)
            return own + (() if self.loop.filter is None else free("filter"))
        found = []
        for number in section.free:
            with self.source.section("tune", "free"):
                try:
                    found.append(number.build(unit_at(self.file, names, number.path)))
                except ValueError as error:
                    raise InputError(f"{number.path}: {error}") from error
        with self.source.section("tune", "free"):
            return free(found)

    def with_numbers(self, loop: ClosedLoop, paths: tuple[str, ...]) -> "Study":
        """This study with the numbers that `loop`, tuned say, has at `paths`.

        Raises `InputError` for one that a study file does not hold.
        """
        return self.changed(entries_of(self.file, loop, paths))

    @property
    def sweep_arguments(self) -> dict[str, Any]:
        """`sweep(**study.sweep_arguments)` is the study's sweep."""
        return {"loop": self.loop, "spread": self.spread, "scenario": self.scenario, **self.settings.numbers()}

    def die(self, number: int | None) -> tuple[ClosedLoop, Scenario]:
        """Die `number` of the study's sweep, as a loop of one die; the design itself for None."""
        if number is None:
            return self.loop, self.scenario
        # Its filter has the series of the design's, as in the sweep, and not one chosen for this die.
        sampled = self.loop.sampled_at(self.settings.sample_rate, duration=self.settings.duration)
        design = jax.tree.map(_given, sampled, is_leaf=lambda part: isinstance(part, Exact))
        drawn = self.spread.draw(design, self.scenario, self.settings.seed, np.array([number]))
        return jax.tree.map(
            lambda one, design: one[..., 0] if jnp.ndim(one) > jnp.ndim(design) else one,
            (drawn.loop, drawn.scenario),
            (design, self.scenario),
        )

    def changed(self, changes: dict[str, Any]) -> "Study":
        """This study with entries replaced by dotted name, for example `{"sweep.dies": 64, "device.mass": "2e-7 kg"}`.

        Raises `InputError` as for a file with these entries.
        """
        data, complete = _data(self.given, None), _data(self.file, None)
        for path, value in changes.items():
            *tables, key = path.split(".")
            here, whole = data, complete
            for table in tables:
                whole = whole.get(table, {})
                # A section left to the device has its kind from there.
                here = here.setdefault(table, {"kind": whole["kind"]} if "kind" in whole else {})
            here[key] = value
        # A line of the file would name a value that the change has replaced.
        changed = Source(f"{self.source.name}, changed", self.source.folder)
        return replace(read_study(data, changed, self.own), source=self.source)

    def to_toml(self, folder: str | Path | None = None) -> str:
        """The study as a file; names of recorded rates are relative to `folder` where they lie below it."""
        data = _data(self.file, folder)
        head = f"schema = {toml_text(data.pop('schema'))}\n"
        tables = [
            toml_table(section, entries)
            if isinstance(entries, dict)
            else "\n".join(toml_table(f"[{section}]", entry) for entry in entries)
            for section, entries in data.items()
        ]
        return "\n".join([head, *tables])

    def write(self, path: str | Path) -> Path:
        """Write the study file `path`, whole or not at all."""
        return write_whole(path, self.to_toml(Path(path).parent))

    def __repr__(self) -> str:
        return f"Study of {self.source.name}\n{self.to_toml()}"


def read_study(data: dict[str, Any], source: Source, own: Sequence[Effect] = ()) -> Study:
    """The study that the parsed TOML `data` describes; `own` are effects beyond the catalogue.

    Raises `InputError` with everything that is wrong with it.
    """
    return _build(checked(StudyFile, data, source, {FOLDER: source.folder}), source, tuple(own))


def _build(given: StudyFile, source: Source, own: tuple[Effect, ...]) -> Study:
    gyro, model = device_of(given, source, own)
    with source.section("readout"):
        readout = readout_of(given, model)
    file = completed(given, gyro, readout)
    with source.section("observer"):
        observer = file.observer.build(gyro, readout)
    with source.section("controller"):
        controller = file.controller.build(gyro, readout)  # type: ignore[union-attr]  # `completed` gives one
    controller = controller if file.actuators is None else file.actuators.around(controller)
    start = (*file.loop.displacement, *file.loop.velocity)
    plant = discretisation(file.loop.discretisation)
    filter_ = file.filter and file.filter.build()
    loop = ClosedLoop(gyro, readout, observer, controller, start, file.loop.travel, plant, filter_)
    file = rested(file, loop)
    if file.loop.block is not None:
        with source.section("loop", "block"):
            loop = loop.in_blocks(file.loop.block)
    scenario = file.scenario.build()
    if filter_ is not None:
        with source.section("filter"):
            check_fits(filter_, loop.output_rate(file.sweep.sample_rate))
    with source.section("sweep", "sample_rate"):
        loop.sampled_at(file.sweep.sample_rate)
    with source.section("sweep", "settle"):
        settle, duration = file.sweep.settle, file.sweep.numbers()["duration"]
        if settle is not None and settle >= duration:
            raise InputError(f"must be shorter than the duration of {duration:g} s, but is {settle:g} s.")
    with source.section("spread"):
        for path in file.spread.parameters:
            Vary(path, Normal()).read(Root(loop, scenario))
        spread = file.spread.build(lambda path: _unit_of_gyro(gyro, path) or file.unit_of(path))
        for item in spread.items:
            item.read(Root(loop, scenario))
        if "spread" in given.model_fields_set:
            spread.resolved(loop)
    return Study(loop, scenario, spread, file, given, source, own)


def _unit_of_gyro(gyro: AbstractGyro, path: str) -> str | None:
    """The unit of `device.quadrature`, `device.effects.0.strength` and `device.effects.parasitic_mode_x.omega`."""
    head, _, last = path.rpartition(".")
    if gyro.natural and (unit := gyro.natural.units.get(path.removeprefix("device."))):
        return unit
    if not head.startswith("device.effects."):
        return None
    effect = Vary(head.removeprefix("device."), Normal()).find(gyro)
    return effect.unit if last == "strength" else unit_of_setting(effect, last) or None


def _data(file: StudyFile, folder: str | Path | None) -> dict[str, Any]:
    dumped = file.model_dump(by_alias=True, exclude_none=True, context={FOLDER: folder})
    return _without_empty(dumped)


def _without_empty(value: Any) -> Any:
    """Tables without the entries that say nothing: empty lists and tables are what their absence means."""
    if isinstance(value, dict):
        kept = {name: _without_empty(entry) for name, entry in value.items()}
        return {name: entry for name, entry in kept.items() if entry not in ((), [], {})}
    return [_without_empty(entry) for entry in value] if isinstance(value, list | tuple) else value
