"""Whether the tests can fail: plants one fault after the other in a copy of the package and runs the tests on it.

    python tests/seeded_faults.py                  # every fault, a few seconds each where programs are compiled
    python tests/seeded_faults.py readout scenario # faults whose file has one of these words in its path
    python tests/seeded_faults.py --all            # a fault that its own tests miss meets the whole default suite

Each fault is one wrong line of physics, statistics or input: a sign, a factor, an index, an axis, a root. A fault that
no test sees is a hole in the tests: write the test that sees it, do not drop the fault. The table of faults is
`seeded_faults.toml`; `old` must stand exactly once in its file, so that a fault never goes stale unnoticed. It names
the cheapest test of the default suite that sees each; who moves that test or marks it slow names another there. The
tests run in a fork of this process, which has imported the libraries once.
"""

import argparse
import contextlib
import multiprocessing
import os
import shutil
import signal
import sys
import tempfile
import time
import tomllib
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path


LIBRARIES = ("jax.numpy", "equinox", "scipy.stats", "xarray", "pydantic", "pint", "matplotlib.pyplot", "pytest")
ROOT = Path(__file__).resolve().parent.parent
SEEN = 1  # exit status of pytest when tests failed
LIMIT = 900.0  # seconds for the tests on one fault


@dataclass(frozen=True)
class Fault:
    """A line of `file` that reads `old` and is made `new`; `tests` are looked at first."""

    file: str
    old: str
    new: str
    tests: tuple[str, ...]

    def text(self, package: Path) -> str:
        """The file's right text, in which the line must stand."""
        text = (package / self.file).read_text()
        if text.count(self.old) != 1 or self.old == self.new:
            found = text.count(self.old)
            raise SystemExit(f"{self.file}: `{self.old}` must stand there once, but stands {found} times.")
        return text

    def planted(self, package: Path) -> str:
        """Plant it in a copy of the package; the file's right text."""
        text = self.text(package)
        (package / self.file).write_text(text.replace(self.old, self.new))
        return text


def faults(words: list[str]) -> list[Fault]:
    """Those of the table whose file has one of the words in its path; without words all."""
    table = tomllib.loads((ROOT / "tests" / "seeded_faults.toml").read_text())["fault"]
    every = [Fault(one["file"], one["old"], one["new"], tuple(one["tests"])) for one in table]
    return [fault for fault in every if not words or any(word in fault.file for word in words)]


def main() -> None:
    """Run, tell each fault's end as it comes, and exit with 1 where one was not seen."""
    parser = argparse.ArgumentParser(description="Plants faults in a copy of the package and runs its tests.")
    parser.add_argument("words", nargs="*")
    parser.add_argument("--all", action="store_true", help="what a room misses meets the whole suite")
    options = parser.parse_args()
    chosen, missed = faults(options.words), []
    for fault in chosen:
        fault.text(ROOT / "memsgyro_jax")
    for library in LIBRARIES:
        import_module(library)
    with tempfile.TemporaryDirectory() as place:
        copy = Path(place) / "project"
        shutil.copytree(ROOT, copy, ignore=shutil.ignore_patterns(".git", ".venv", "__pycache__", ".*_cache", "site"))
        for number, fault in enumerate(chosen, 1):
            begin = time.monotonic()
            by = seen_by(fault, copy, options.all)
            print(f"{number}/{len(chosen)} {fault.file}: `{fault.old}` -> `{fault.new}`")
            print(f"    {by or 'NOT SEEN'} ({time.monotonic() - begin:.0f} s)", flush=True)
            if by is None:
                missed.append(fault)
    print(f"{len(chosen) - len(missed)} of {len(chosen)} faults seen.")
    sys.exit(bool(missed))


def seen_by(fault: Fault, copy: Path, everything: bool) -> str | None:
    """The first test that fails with the fault, or None."""
    right = fault.planted(copy / "memsgyro_jax")
    try:
        return failing(copy, ("-n", "0", *fault.tests)) or (failing(copy, ("-n", "2")) if everything else None)
    finally:
        (copy / "memsgyro_jax" / fault.file).write_text(right)


def failing(copy: Path, arguments: tuple[str, ...]) -> str | None:
    """The first test that fails in the copy."""
    printed = copy.parent / "printed.txt"
    ran = multiprocessing.get_context("fork").Process(target=tested, args=(copy, printed, arguments))
    ran.start()
    ran.join(LIMIT)
    if ran.exitcode is None:
        os.killpg(ran.pid, signal.SIGKILL)
        ran.join()
        return f"no end after {LIMIT:.0f} s"
    if ran.exitcode == 0:
        return None
    named = [line for line in printed.read_text().splitlines() if line.startswith(("FAILED", "ERROR"))]
    if ran.exitcode != SEEN or not named:
        raise SystemExit(
            f"pytest ended with {ran.exitcode}; are these default tests? {arguments}\n{printed.read_text()}"
        )
    return named[0].split(" - ")[0]


def tested(copy: Path, printed: Path, arguments: tuple[str, ...]) -> None:
    """Run pytest in the copy, as the process that this is, and end with its status."""
    import pytest

    os.setsid()
    os.chdir(copy)
    os.environ["PYTHONPATH"] = str(copy)
    sys.path[0] = str(copy)
    early = "ignore::pytest.PytestAssertRewriteWarning"  # of plugins that the libraries have imported
    with printed.open("w") as file, contextlib.redirect_stdout(file), contextlib.redirect_stderr(file):
        status = pytest.main(["-x", "-q", "-p", "no:cacheprovider", "-W", early, *arguments])
    os._exit(status)


if __name__ == "__main__":
    main()
