"""Pages that are made from the code: the catalogue, the API by room, the picture of the rooms, the gallery."""

import importlib
import inspect
import pkgutil
import re
import tomllib
from collections import Counter
from html import escape
from pathlib import Path

import memsgyro_jax
from memsgyro_jax.app.claims import all_studies, studies_folder
from memsgyro_jax.effects import TERMS, Effect, catalogue
from memsgyro_jax.measurement.case.device import BY_MASS, BY_MODES
from memsgyro_jax.measurement.declared import VOCABULARIES


PACKAGE = Path(memsgyro_jax.__file__).parent
ROOMS = {
    "base": "what any scientific program needs and no gyroscope",
    "device": "the mass on its springs: parameters, equations of motion, exact propagation",
    "effects": "physics beyond the base model",
    "loop": "one die in operation: read-out, observer, controller, trace, information bound",
    "montecarlo": "many dies: spread, sweep, store, sensitivities",
    "motion": "the motion that tells the rate best",
    "tuning": "numbers of the loop moved by gradient",
    "measurement": "what a laboratory records, and how a device predicts it",
    "couplings": "coupling errors from frequency sweeps",
    "diagnosis": "a device beside its records: where the model fails, what is missing",
    "app": "the command line, study files, report pages",
}
PORTS = (  # abstract class, what its members are
    ("device.gyro.AbstractGyro", "devices"),
    ("device.propagate.AbstractDiscretisation", "ways to advance the motion by a sample"),
    ("loop.readout.AbstractReadout", "read-outs"),
    ("loop.observers.base.AbstractObserver", "observers"),
    ("loop.observers.fading.AbstractFading", "fading memories of a Kalman filter"),
    ("loop.controllers.base.AbstractController", "controllers"),
    ("loop.controllers.sense.AbstractSense", "sense axes of the classic loop"),
    ("loop.controllers.demodulator.AbstractDemodulator", "demodulators of the classic loop"),
    ("loop.filters.AbstractFilter", "filters of the estimated rate"),
    ("loop.scenario.AbstractProfile", "courses of rate, temperature, damping over time"),
    ("montecarlo.distributions.AbstractDistribution", "distributions of a spread"),
    ("tuning.losses.base.AbstractLoss", "losses that tuning makes small"),
    ("measurement.experiments.record.AbstractRecord", "kinds of measurement"),
    ("measurement.formats.base.Format", "formats of files that instruments save"),
)


def everything(figures: list[tuple[str, str, str]]) -> dict[str, str]:
    """Every generated file, by its path; `figures` are path, description and page of those of all pages."""
    return {
        "catalogue.md": catalogue_page(),
        "studies.md": studies_page(),
        "gallery.md": gallery(figures),
        **api_pages(),
    }


def catalogue_page() -> str:
    """Effects with law, unit, variants and reference; then the members of every port."""
    lines = ["# Catalogue", "", "Made from the code of this version. `memsgyro effects` prints the first table.", ""]
    lines += [
        "## Effects",
        "",
        'Strength zero means absent, exactly. `mg.effects.CubicStiffness("x", 8e8)` is one with a strength.',
        "",
    ]
    entries: dict[tuple[str, str], list[Effect]] = {}
    for effect in catalogue(2):
        entries.setdefault((effect.name, effect.law), []).append(effect)
    lines += ["| effect | unit | variants | law | reference |", "|---|---|---|---|---|"]
    for (name, law), group in entries.items():
        kind = type(group[0]).__name__
        where = ", ".join(effect.where for effect in group if effect.where)
        cells = (f"[`{name}`][memsgyro_jax.effects.{kind}]", group[0].unit, where, law, group[0].reference)
        lines.append(table_row(cells))
    lines += ["", "## What an instrument may do", ""]
    lines += ["Tried before any effect of the device, for all records or for each.", ""]
    lines += ["| term | unit | law | is |", "|---|---|---|---|"]
    for term in TERMS:
        lines.append(table_row((f"`{term.name}`", term.unit, term.law, _first(term))))
    for path, what in PORTS:
        module, _, name = f"memsgyro_jax.{path}".rpartition(".")
        port = getattr(importlib.import_module(module), name)
        lines += ["", f"## {what[0].upper()}{what[1:]}", "", f"Subclasses of {_link(port)}: {_first(port)}", ""]
        lines += ["| member | is |", "|---|---|"]
        lines += [table_row((_link(kind), _first(kind))) for kind in _members(port)]
    return "\n".join([*lines, "", *_design_keys()]) + "\n"


def _design_keys() -> list[str]:
    """What `[design]` of a case may hold, per device."""
    lines = ["## Keys of a case's design", ""]
    said = "Each as `{ value, tolerance, unit }` or `{ low, high, unit }`, in any unit of the kind; "
    said += "what is left out is found from the records."
    lines += [said, "", "| device | key | unit | may be given instead |", "|---|---|---|---|"]
    for device, words in VOCABULARIES.items():
        other = BY_MODES if device == "single_mass" else BY_MASS
        for key, unit in words.design.items():
            si = "m/N once read-out and drive are calibrated, else readings per drive" if key == "static_gain" else unit
            instead = f"`{other[key].key}` [{other[key].unit}]" if key in other else ""
            lines.append(table_row((f"`{device}`", f"`{key}`", si, instead)))
    return lines


def api_pages() -> dict[str, str]:
    """A page for each room that has public names, and one that lists all of them."""
    pages = {}
    overview = [
        "# API",
        "",
        "`import memsgyro_jax as mg`; every name below is `mg.NAME`. The rooms are those of the",
        "",
    ]
    overview[-2] += " [architecture](../architecture.md)."
    rooms = by_room()
    for room, names in rooms.items():
        lines = [f"# {room}", "", f"{ROOMS[room][0].upper()}{ROOMS[room][1:]}.", ""]
        overview += [f"## [{room}]({room}.md)", "", f"{ROOMS[room][0].upper()}{ROOMS[room][1:]}.", ""]
        overview += [", ".join(f"[`{name}`][memsgyro_jax.{name}]" for name in names), ""]
        for name in names:
            lines += [f"::: memsgyro_jax.{name}", *_members_option(name), ""]
        pages[f"api/{room}.md"] = "\n".join(lines)
    overview += [
        "## Version",
        "",
        f"`mg.__version__` is the version of the package, here {memsgyro_jax.__version__}.",
        "",
    ]
    return {"api/index.md": "\n".join(overview), **pages}


def by_room() -> dict[str, list[str]]:
    """The public names of every room, in the order of the table of contents."""
    where = {**memsgyro_jax._CONTENTS, **memsgyro_jax._FOLDERS}
    names = {room: [name for name, place in where.items() if place.split(".")[0] == room] for room in ROOMS}
    return {room: found for room, found in names.items() if found}


def _members_option(name: str) -> list[str]:
    """Modules that are used by name show what they offer."""
    if name not in memsgyro_jax._FOLDERS:
        return []
    module = getattr(memsgyro_jax, name)
    offered = [key for key, value in vars(module).items() if not key.startswith("_") and _offers(module, value)]
    return ["    options:", "      members:", *(f"        - {key}" for key in offered)]


def _offers(module: object, value: object) -> bool:
    place = getattr(value, "__module__", "")
    inside = place == module.__name__ or (hasattr(module, "__path__") and place.startswith(module.__name__ + "."))
    return inside and (inspect.isclass(value) or inspect.isfunction(value))


def with_calls(html: str) -> str:
    """An API page with the call beneath the name of each class that shows none."""

    def with_call(found: re.Match[str]) -> str:
        kind: object = memsgyro_jax
        for part in found[2].split("."):
            kind = getattr(kind, part, None)
        if not inspect.isclass(kind) or inspect.isabstract(kind):
            return found[0]
        arguments = "".join(f"\n    {argument}," for argument in _arguments(kind))
        name = found[2].rpartition(".")[2]
        text = escape(f"{name}({arguments}\n)" if arguments else f"{name}()")
        return f'{found[0]}<div class="doc-signature highlight"><pre><code>{text}</code></pre></div>'

    heading = r'<h([23]) id="memsgyro_jax\.([\w.]+)"(?:(?!</h\1>).)*</h\1>(?!\s*<div class="doc-signature)'
    return re.sub(heading, with_call, html, flags=re.DOTALL)


def _arguments(kind: type) -> list[str]:
    """The arguments of a class with their defaults, in the order of its call."""
    told, only_named = [], False
    for name, argument in inspect.signature(kind).parameters.items():
        if argument.kind is argument.KEYWORD_ONLY and not only_named:
            told, only_named = [*told, "*"], True
        default = "" if argument.default is argument.empty else f"={_short(argument.default)}"
        told.append(name + default)
    return told


def _short(value: object) -> str:
    """A default that fits on a line; what is made anew each time has none."""
    text = " ".join(repr(value).split())
    return text if len(text) <= 60 and "factory" not in text else "..."


def studies_page() -> str:
    """The rows of the two documents and the studies that answer them, then all studies with their questions."""
    studies = all_studies()
    rows = tomllib.loads((studies_folder() / "rows.toml").read_text(encoding="utf-8"))["rows"]
    lines = ["# The thesis and the paper, row by row", ""]
    lines += [
        "The package was written beside two documents, a thesis on estimation and control of gyroscopes (NCTU 2010)"
    ]
    lines += ["and a paper on their coupling errors. Each row of them is answered by a study, a script that prints"]
    lines += ["*claimed* beside *obtained*: `memsgyro studies NAME` runs one, `--quick` in under half a minute.", ""]
    if (Path(__file__).parents[1] / "claims.md").exists():
        lines += ["What the last full runs found stands in the [table of claims](claims.md).", ""]
    lines += ["| row | system | where | studies |", "|---|---|---|---|"]
    for row, (where, what) in rows.items():
        answered = ", ".join(f"`{study.name}`" for study in studies if row in study.answers)
        lines.append(table_row((row, what, where, answered or "none yet")))
    lines += ["", "## All studies", "", "| study | question |", "|---|---|"]
    lines += [table_row((f"`{study.name}`", study.question)) for study in studies]
    return "\n".join(lines) + "\n"


def gallery(figures: list[tuple[str, str, str]]) -> str:
    """Every figure of every page, small, each a way to the code that made it."""
    lines = [
        "# Gallery",
        "",
        "Every picture was made when this site was built, by the code on the page it leads to.",
        "",
    ]
    lines += ['<div class="gallery" markdown>', ""]
    lines += [
        f"[![{text}]({path}){{ loading=lazy }}<br>{text}]({page})" + "{ .thumbnail }\n" for path, text, page in figures
    ]
    return "\n".join([*lines, "</div>", ""])


def room_imports() -> Counter[tuple[str, str]]:
    """How often a file of one room imports from another."""
    found: Counter[tuple[str, str]] = Counter()
    for path in sorted(PACKAGE.rglob("*.py")):
        room = path.relative_to(PACKAGE).parts[0]
        if room not in ROOMS:
            continue
        others = re.findall(r"^\s*from memsgyro_jax\.(\w+)", path.read_text(), re.MULTILINE)
        found.update((room, other) for other in others if other != room)
    return found


def rooms_picture() -> str:
    """The rooms in their order, each with its files and its lines, and an arc for every room that it imports from."""
    imports, order = room_imports(), list(ROOMS)
    step, left, right = 46, 8, 168
    parts = []
    for (source, target), count in sorted(imports.items(), key=lambda entry: entry[1]):
        top, bottom = (order.index(name) * step + 27 for name in (target, source))
        bulge = right + 14 + 21 * (order.index(source) - order.index(target))
        path = f"M{right},{bottom} C{bulge},{bottom} {bulge},{top} {right},{top}"
        told = f"{source} imports from {target} {count} times"
        parts.append(
            f'<path class="arc" d="{path}" stroke-width="{0.6 + 0.35 * count**0.5:.2f}"><title>{told}</title></path>'
        )
    for number, room in enumerate(order):
        files = list((PACKAGE / room).rglob("*.py"))
        lines = sum(len(path.read_text().splitlines()) for path in files)
        y = number * step + 8
        parts.append(
            f'<rect x="{left}" y="{y}" width="{right - left}" height="38" rx="6"/>'
            f'<text x="{left + 10}" y="{y + 17}" class="room">{room}</text>'
            f'<text x="{left + 10}" y="{y + 31}">{len(files)} files, {lines} lines</text>'
        )
    size = f"0 0 400 {len(order) * step + 8}"
    return f'<svg class="rooms" viewBox="{size}" role="img" aria-label="rooms of the package">{"".join(parts)}</svg>'


def rooms_table() -> str:
    """The rooms, each with what it holds and the way to its public names."""
    public = by_room()
    names = ((f"[`{room}`](api/{room}.md)" if room in public else f"`{room}`", what) for room, what in ROOMS.items())
    return "\n".join(table_row(cells) for cells in names)


PLACES = {"rooms": rooms_picture, "rooms table": rooms_table}  # comment in a page, what stands in its place


def _members(port: type) -> list[type]:
    """Final classes of the package that fill a port, whatever file they are in."""
    for module in pkgutil.walk_packages(memsgyro_jax.__path__, "memsgyro_jax."):
        importlib.import_module(module.name)
    waiting, found = [port], {}
    while waiting:
        kind = waiting.pop()
        waiting += kind.__subclasses__()
        inside = kind.__module__.startswith("memsgyro_jax.") and not kind.__name__.startswith(("_", "Abstract"))
        if kind is not port and inside and not inspect.isabstract(kind):
            found[kind.__name__] = kind
    return [found[name] for name in sorted(found)]


def _link(kind: type) -> str:
    """The name of a class, as a link where it is public."""
    name = kind.__name__
    if name in memsgyro_jax._CONTENTS:
        return f"[`{name}`][memsgyro_jax.{name}]"
    for folder in memsgyro_jax._FOLDERS:
        if getattr(getattr(memsgyro_jax, folder), name, None) is kind:
            return f"[`{folder}.{name}`][memsgyro_jax.{folder}.{name}]"
    return f"`{name}`"


def _first(kind: type) -> str:
    """The first sentence of a docstring."""
    text = " ".join((inspect.getdoc(kind) or "").split("\n\n")[0].split())
    return re.split(r"(?<=\.) ", text)[0]


def table_row(cells) -> str:
    """A row of a table."""
    return "| " + " | ".join(str(cell).replace("|", "\\|").replace("*", "\\*") for cell in cells) + " |"
