"""Runs the code blocks of a page, in order, in one process and one folder, and writes beneath each what it gave.

| block | what happens |
|---|---|
| `python` | is run; what it prints and the figures it leaves open follow it |
| `sh` | is run line by line; what it prints follows it |
| `python`, `toml`, `csv` with `title="NAME"` | is written to the file of that name |
| `console` | must stand word by word in the README, whose commands the continuous integration runs |

A comment behind a block says more: `<!-- figure: TEXT -->` describes its figure, `<!-- page: FILE TEXT -->` takes along
a page that it wrote, and with `<!-- shows: TEXT -->` the build fails where TEXT is not printed.
"""

import contextlib
import hashlib
import io
import json
import os
import re
import shlex
import subprocess
import sys
import tempfile
import traceback
from dataclasses import asdict, dataclass, field
from pathlib import Path


ROOT = Path(__file__).resolve().parents[2]
FENCE = re.compile(r"^```(\w+)(?: title=\"([^\"]+)\")?\n(.*?)^```\n?", re.MULTILINE | re.DOTALL)
NOTE = re.compile(r"\n?<!-- (figure|page|shows): ([^\n]*?) -->\n")
KEPT = ROOT / ".docs-cache"  # results of pages whose blocks and whose package have not changed


class BlockError(Exception):
    """A block of a page did not do what the page says; the message begins with page and line."""


def prepare() -> None:
    """Sets JAX and matplotlib up, once, before a page is run."""
    os.environ.setdefault("COLUMNS", "100")
    from memsgyro_jax.base import runtime

    runtime.configure()
    import matplotlib as mpl

    mpl.use("agg")
    mpl.rcParams.update({"svg.hashsalt": "memsgyro", "figure.figsize": (7.2, 3.6), "figure.max_open_warning": 0})


@dataclass
class Executed:
    """A page whose blocks have been run: its text, and the files that it made, by path from the root of the site."""

    text: str
    figures: list[tuple[str, str]] = field(default_factory=list)  # path and description
    files: dict[str, str] = field(default_factory=dict)  # path and text


def execute(name: str, text: str) -> Executed:
    """The page `name` (its path in `docs`) with the results of its blocks, from the cache where nothing has changed."""
    if not FENCE.search(text):
        return Executed(text)
    kept = KEPT / f"{Path(name).stem}-{_fingerprint(text)}.json"
    if kept.exists():
        return Executed(**json.loads(kept.read_text()))
    with tempfile.TemporaryDirectory() as folder, _inside(Path(folder)):
        done = _Page(name, text).run()
    kept.parent.mkdir(exist_ok=True)
    for old in kept.parent.glob(f"{Path(name).stem}-*.json"):
        old.unlink()
    kept.write_text(json.dumps(asdict(done)))
    return done


def _fingerprint(text: str) -> str:
    sources = [*sorted((ROOT / "memsgyro_jax").rglob("*.py")), Path(__file__)]
    return hashlib.sha256(b"".join([text.encode(), *(path.read_bytes() for path in sources)])).hexdigest()[:16]


@contextlib.contextmanager
def _inside(folder: Path):
    """In `folder`, beside the tests' data, with this Python's commands first."""
    (folder / "tests").symlink_to(ROOT / "tests")
    before, path = Path.cwd(), os.environ["PATH"]
    os.environ["PATH"] = f"{Path(sys.executable).parent}{os.pathsep}{path}"
    os.chdir(folder)
    try:
        yield
    finally:
        os.chdir(before)
        os.environ["PATH"] = path


class _Page:
    """One page while its blocks are run."""

    def __init__(self, name: str, text: str):
        self.name, self.text, self.names = name, text, {"__name__": "__main__"}
        self.done = Executed("")

    def run(self) -> Executed:
        import matplotlib.pyplot as plt

        plt.close("all")  # figures that were open before are not the page's
        place = 0
        while block := FENCE.search(self.text, place):
            line = self.text.count("\n", 0, block.start()) + 2  # of the first line inside the block
            self.done.text += self.text[place : block.end()]
            place = block.end()
            wanted = []
            while note := NOTE.match(self.text, place):
                wanted.append((note[1], note[2]))
                place = note.end()
            self.one(*block.groups(), line, wanted)
        self.done.text += self.text[place:]
        return self.done

    def one(self, language: str, title: str | None, code: str, line: int, wanted: list[tuple[str, str]]) -> None:
        """Runs a block and adds its results to the page."""
        printed = ""
        if title:
            Path(title).write_text(code)
        elif language == "python":
            printed = self.printed(line, lambda: self.python(code, line))
        elif language == "sh":
            for number, command in enumerate(_commands(code)):
                printed += self.printed(line + number, lambda command=command: _shell(command))
        elif language == "console":
            strange = [text for text in code.splitlines() if text not in (ROOT / "README.md").read_text().splitlines()]
            if strange:
                self.fail(line, f"the README must hold this command too: {strange[0]}")
        elif language != "text":
            self.fail(line - 1, f"a block of `{language}` needs a title, the file it stands for")
        if printed.strip():
            self.done.text += f"\n``` {{ .text .output }}\n{printed.strip(chr(10))}\n```\n"
        self.figures([text for kind, text in wanted if kind == "figure"], line, language)
        self.pages([text for kind, text in wanted if kind == "page"], line)
        for kind, text in wanted:
            if kind == "shows" and text not in " ".join(printed.split()):
                self.fail(line, f"must print {text!r}, but prints\n{printed}")

    def printed(self, line: int, run) -> str:
        """What `run()` prints."""
        out, err = io.StringIO(), io.StringIO()
        try:
            with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
                run()
        except Exception as error:
            place = [frame.lineno for frame in traceback.extract_tb(error.__traceback__) if frame.filename == self.name]
            trail = "" if isinstance(error, BlockError) else traceback.format_exc(limit=-3)
            self.fail(place[-1] if place else line, f"{out.getvalue()}{err.getvalue()}{trail}{error}")
        return out.getvalue()

    def python(self, code: str, line: int) -> None:
        exec(compile("\n" * (line - 1) + code, self.name, "exec"), self.names)

    def figures(self, told: list[str], line: int, language: str) -> None:
        """Puts the open figures into the page."""
        import matplotlib.pyplot as plt

        numbers = plt.get_fignums() if language == "python" else []
        if len(numbers) != len(told):
            self.fail(line, f"leaves {len(numbers)} figures, but {len(told)} are described")
        for number, text in zip(numbers, told, strict=True):
            path = f"figures/{Path(self.name).stem}-{len(self.done.figures) + 1}.svg"
            drawn = io.StringIO()
            plt.figure(number).savefig(drawn, format="svg", bbox_inches="tight", metadata={"Date": None})
            self.done.files[path] = drawn.getvalue()
            self.done.figures.append((path, text))
            self.done.text += f"\n![{text}]({path}){{ .figure loading=lazy }}\n"
        plt.close("all")

    def pages(self, told: list[str], line: int) -> None:
        """Takes HTML pages along that the block wrote."""
        for entry in told:
            file, _, text = entry.partition(" ")
            if not Path(file).exists():
                self.fail(line, f"must write {file}")
            path = f"reports/{Path(self.name).stem}-{file.replace('/', '-')}"
            self.done.files[path] = Path(file).read_text()
            self.done.text += f"\n[{text}]({path}){{ .report }}\n"

    def fail(self, line: int, why: str):
        raise BlockError(f"docs/{self.name}:{line}: {why}") from None


def _commands(code: str) -> list[str]:
    """Lines of a block, those that end in a backslash joined."""
    return [line for line in code.replace("\\\n", " ").splitlines() if line and not line.startswith("#")]


def _shell(command: str) -> None:
    """Runs a command; `memsgyro` itself in this process, which has JAX and its programs already."""
    if command.startswith("memsgyro ") and not set(command) & set("|<>$;&*"):
        from memsgyro_jax.app.cli import main

        try:
            main(shlex.split(command)[1:])
        except SystemExit as ended:
            if ended.code:
                raise BlockError(f"`{command}` ended with status {ended.code}") from None
        return
    ran = subprocess.run(["bash", "-c", command], capture_output=True, text=True, check=False)
    print(ran.stdout, end="")
    if ran.returncode:
        raise BlockError(f"`{command}` ended with status {ran.returncode}: {ran.stderr}")
