"""The layout holds: imports point one way, files stay short, nothing names the machine it was written on."""

import ast
import importlib
import re
import tomllib
from collections import defaultdict
from collections.abc import Sequence
from functools import cache
from graphlib import CycleError, TopologicalSorter
from pathlib import Path
from typing import NamedTuple

import pytest
import seeded_faults

import memsgyro_jax


pytestmark = pytest.mark.smoke

ROOT = Path(__file__).resolve().parent.parent
PACKAGE = ROOT / "memsgyro_jax"
MODULES = sorted(PACKAGE.rglob("*.py"))
ROOMS = [path for path in MODULES if path != PACKAGE / "__init__.py"]  # the table of contents imports on first use only

# A module imports only from modules above it. A folder counts as one place; inside it, imports may not go in a circle.
ORDER = [
    "base",
    "device",
    "effects",
    "loop",
    "montecarlo",
    "motion",
    "tuning",
    "measurement",
    "couplings",
    "diagnosis",
    "app",
]

TOP_LEVEL = {
    ".ci", ".gitignore", ".python-version", "CHANGELOG.md", "CITATION.cff", "CONTRIBUTING.md", "LICENSE", "README.md",
    "docs", "examples", "memsgyro_jax", "mkdocs.yml", "pyproject.toml", "studies", "tests", "uv.lock",
}  # fmt: skip
TEXT = {".py", ".md", ".toml", ".yml", ".cff", ".html", ".css", ".csv", ""}


def place(path: Path) -> str:
    """The name in ORDER under which a file stands."""
    return path.relative_to(PACKAGE).parts[0].removesuffix(".py")


class Outline(NamedTuple):
    """Of a file its imports anywhere in the text, those at the top, and the public names that it defines."""

    imports: tuple[ast.Import | ast.ImportFrom, ...]
    at_once: tuple[ast.Import | ast.ImportFrom, ...]
    defined: tuple[str, ...]


@cache  # parsing the package takes half a second, and four tests ask
def outline(text: str) -> Outline:
    """What a text imports and defines."""
    tree = ast.parse(text)
    imports, at_once = (
        tuple(node for node in nodes if isinstance(node, ast.Import | ast.ImportFrom))
        for nodes in (ast.walk(tree), tree.body)
    )
    named = (node.name for node in tree.body if isinstance(node, ast.FunctionDef | ast.ClassDef))
    return Outline(imports, at_once, tuple(name for name in named if not name.startswith("_")))


def names_imported(path: Path) -> list[list[str]]:
    """Dotted names that a file imports, anywhere in its text, for type checkers too."""
    package = ("memsgyro_jax", *path.relative_to(PACKAGE).parent.parts)
    names = []
    for node in outline(path.read_text()).imports:
        if isinstance(node, ast.Import):
            names += [alias.name.split(".") for alias in node.names]
        else:
            base = package[: len(package) - node.level + 1] if node.level else ()
            module = [*base, *(node.module.split(".") if node.module else [])]
            names += [[*module, alias.name] for alias in node.names]
    return names


def imported(path: Path) -> set[str]:
    """Rooms of this package that a file imports."""
    names = names_imported(path)
    # `from memsgyro_jax import fit` means the public name, `from .fit import Fit` the module.
    places = {
        memsgyro_jax._CONTENTS.get(name[1], name[1]).split(".")[0] if len(name) == 2 else name[1]
        for name in names
        if name[0] == "memsgyro_jax" and len(name) > 1
    }
    return places & set(ORDER)


def repository_files() -> list[Path]:
    """What belongs to the repository, told without git: everything but hidden folders, caches and build results."""
    skip = re.compile(r"__pycache__|\.egg-info|^(dist|build|site|sweep-out|studies/out)$")
    found, waiting = [], [ROOT]
    while waiting:
        for path in waiting.pop().iterdir():
            if skip.search(path.relative_to(ROOT).as_posix()) or (path.name.startswith(".") and path.name != ".ci"):
                continue
            (waiting if path.is_dir() else found).append(path)
    return found


def test_every_module_has_its_place():
    unknown = {place(path) for path in MODULES} - {*ORDER, "__init__"}
    assert not unknown, f"give {unknown} a place in ORDER (and in the README's structure)"


def test_imports_point_up_the_list():
    below = {path: imported(path) - {*ORDER[: ORDER.index(place(path)) + 1]} for path in ROOMS}
    assert not {path: names for path, names in below.items() if names}, "they stand below the file that imports them"


def test_the_import_test_sees_every_form(tmp_path, monkeypatch):
    monkeypatch.setattr(f"{__name__}.PACKAGE", tmp_path)
    (tmp_path / "motion").mkdir()
    file = tmp_path / "motion" / "aim.py"
    file.write_text(
        "import memsgyro_jax.loop\nfrom .. import tuning\nfrom ..app import cli\nfrom .plant import Plant\n"
        "def f():\n    from memsgyro_jax.montecarlo.merit import rms\n    from memsgyro_jax import InputError\n"
    )
    assert imported(file) == {"loop", "tuning", "app", "motion", "montecarlo", "base"}


def circle(package: Path) -> list[str]:
    """Files that import each other, directly or through others, anywhere in their text."""
    rooms = [path for path in package.rglob("*.py") if path.parent != package]
    named = {".".join(("memsgyro_jax", *path.relative_to(package).with_suffix("").parts)): path for path in rooms}
    files = {name.removesuffix(".__init__"): path for name, path in named.items()}
    graph = {}
    for name, path in files.items():
        found = [".".join(names) for names in names_imported(path)]
        # `from .gyro import AbstractGyro` names the file and something in it.
        graph[name] = {n if n in files else n.rpartition(".")[0] for n in found} & {*files} - {name}
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as error:
        return error.args[1]
    return []


def test_no_imports_in_a_circle():
    assert circle(PACKAGE) == []


def test_a_circle_for_type_checkers_is_found(tmp_path, monkeypatch):
    monkeypatch.setattr(f"{__name__}.PACKAGE", tmp_path)
    (tmp_path / "loop").mkdir()
    (tmp_path / "loop" / "__init__.py").write_text("from .trace import Trace\n")
    (tmp_path / "loop" / "trace.py").write_text("def plot():\n    from . import pictures\n")
    (tmp_path / "loop" / "pictures.py").write_text("import numpy\n")
    assert circle(tmp_path) == []
    (tmp_path / "loop" / "pictures.py").write_text("if TYPE_CHECKING:\n    from .trace import Trace\n")
    assert {*circle(tmp_path)} == {"memsgyro_jax.loop.trace", "memsgyro_jax.loop.pictures"}


def test_one_name_for_one_thing():
    places = defaultdict(set)
    for path in MODULES:
        for name in outline(path.read_text()).defined:
            places[name].add(path.relative_to(PACKAGE).as_posix())
    assert {name: found for name, found in places.items() if len(found) > 1} == {}


def test_files_stay_short():
    long = [path for path in MODULES if len(path.read_text().splitlines()) >= 350]
    assert not long, "split the file where it holds a second idea"


def test_only_the_report_imports_matplotlib_at_once():
    """Results draw themselves through `.plot`, which imports matplotlib when called; it takes a second."""
    for path in MODULES:
        top = outline(path.read_text()).at_once
        names = [alias.name for node in top for alias in node.names]
        names += [getattr(node, "module", None) or "" for node in top]
        assert "report" in path.parts or not any(name.startswith("matplotlib") for name in names), path


def test_the_package_shows_its_rooms_and_little_else():
    beside = {path.name for path in PACKAGE.iterdir()} - {*ORDER, "__pycache__"}
    assert beside == {"__init__.py", "py.typed", "demo"}


def test_depth_is_at_most_three():
    assert max(len(path.relative_to(PACKAGE).parts) for path in MODULES) <= 3


def test_top_level_layout():
    assert {path.relative_to(ROOT).parts[0] for path in repository_files()} <= TOP_LEVEL


def test_no_path_of_a_machine():
    home = re.compile(r"(?<![\w.])/(?:" + "|".join(["work", "tmp", "root", "home", "Users"]) + r")/")
    found = [
        f"{path.relative_to(ROOT)}:{number}"
        for path in repository_files()
        if path.suffix in TEXT
        for number, line in enumerate(path.read_text().splitlines(), 1)
        if home.search(line)
    ]
    assert not found


def test_planted_faults_are_not_stale():
    """The line that each of them makes wrong, and a default test that sees it, stand where the table says."""
    table = seeded_faults.faults([])
    assert len(table) >= 60
    for fault in table:
        assert fault.text(PACKAGE), fault.file
        assert_default(fault.tests)


def test_what_was_once_silent_is_held_by_tests():
    for case in tomllib.loads((ROOT / "tests" / "never_silent.toml").read_text())["case"]:
        assert_default(case["tests"])


def assert_default(tests: Sequence[str]) -> None:
    """They exist and belong to the default suite."""
    assert tests
    for file, _, name in (test.partition("::") for test in tests):
        assert "slow" not in marks_of(file)[name.partition("[")[0]], name


@cache
def marks_of(file: str) -> dict[str, set[str]]:
    """The decorators of each test of a file, by the last part of their names."""
    body = ast.parse((ROOT / file).read_text()).body
    tests = [node for node in body if isinstance(node, ast.FunctionDef)]
    return {test.name: {ast.unparse(mark).split(".")[-1] for mark in test.decorator_list} for test in tests}


def test_every_public_name_can_be_imported():
    for name in memsgyro_jax.__all__:
        assert getattr(memsgyro_jax, name) is not None
    assert {*memsgyro_jax.__all__} <= {*dir(memsgyro_jax)}


def test_public_names_are_documented():
    """A class or function of the table of contents says what it is."""
    bare = [name for name in memsgyro_jax._CONTENTS if not getattr(memsgyro_jax, name).__doc__]
    assert not bare


def test_an_unknown_name_is_an_attribute_error():
    with pytest.raises(AttributeError, match="no_such_name"):
        _ = memsgyro_jax.no_such_name


def test_importing_the_package_starts_nothing(fresh_python):
    done = fresh_python("-c", "import sys, memsgyro_jax; print('jax' in sys.modules, 'numpy' in sys.modules)")
    assert done.stdout == "False False\n"


def test_modules_import_on_their_own():
    for name in sorted({place(path) for path in MODULES} - {"__init__"}):
        assert importlib.import_module(f"memsgyro_jax.{name}").__doc__, f"{name} lacks a docstring"
