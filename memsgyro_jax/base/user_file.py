"""A Python file of the user's own: run, and asked for the classes it defines."""

import ast
import importlib.util
import sys
import traceback
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import TypeVar

from .errors import InputError
from .files import read_text
from .own_code import untraced


MODULE = "memsgyro_file_of_user"
Port = TypeVar("Port")


@dataclass(frozen=True, eq=False)
class UserFile:
    """A file that was run.

    Args:
        path: of the file.
        module: what it defines.
        lines: of each class by its name.
    """

    path: Path
    module: ModuleType
    lines: Mapping[str, int]

    def at(self, kind: type) -> str:
        """File and line of a class, for messages."""
        line = self.lines.get(kind.__name__)
        return f"{self.path}, line {line}" if line else str(self.path)

    def final(self, port: type[Port]) -> list[type[Port]]:
        """Subclasses of a port in the order of the file, without those that others of the file build on."""
        values = dict.fromkeys(value for value in vars(self.module).values() if isinstance(value, type))
        own = [kind for kind in values if issubclass(kind, port) and kind.__module__ == MODULE]
        return [kind for kind in own if not any(other is not kind and issubclass(other, kind) for other in own)]


def run_user_file(path: str | Path) -> UserFile:
    """Run a file, which is running a program: only what one would run; `InputError` with file and line if it fails."""
    path = Path(path)
    source = read_text(path, "Python file")
    module = _run(path, source)
    lines = {node.name: node.lineno for node in ast.walk(ast.parse(source)) if isinstance(node, ast.ClassDef)}
    return UserFile(path, module, lines)


def _run(path: Path, source: str) -> ModuleType:
    spec = importlib.util.spec_from_loader(MODULE, loader=None, origin=str(path))
    assert spec is not None
    module = importlib.util.module_from_spec(spec)
    module.__file__ = str(path)
    before = sys.modules.get(MODULE)
    sys.modules[MODULE] = module  # dataclasses look the module of a class up
    try:
        exec(compile(source, str(path), "exec"), module.__dict__)
    except SyntaxError as error:
        raise InputError(f"{path}, line {error.lineno}: must be valid Python, but: {error.msg}.") from error
    except (Exception, SystemExit) as error:
        raise InputError(f"{line_of(error, path, str(path))}: must run, but: {in_one_line(error)}.") from error
    finally:
        if before is None:
            del sys.modules[MODULE]
        else:
            sys.modules[MODULE] = before
    return module


def line_of(error: BaseException, path: Path, otherwise: str) -> str:
    """The line of the file that an error came from, where it came from the file."""
    numbers = [frame.lineno for frame in traceback.extract_tb(error.__traceback__) if frame.filename == str(path)]
    return f"{path}, line {numbers[-1]}" if numbers else otherwise


def in_one_line(error: BaseException) -> str:
    """An error in one line, without the closing full stop."""
    if words := untraced(error):
        return f"it {words}"
    first = str(error).strip().split("\n")[0].rstrip(".: ")
    return f"{type(error).__name__}: {first}" if first else type(error).__name__
