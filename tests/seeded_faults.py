"""Whether the tests can fail: plants one fault after the other in a copy of the package and runs the tests on it.

    python tests/seeded_faults.py                  # every fault; long
    python tests/seeded_faults.py readout scenario # faults whose file has one of these words in its path
    python tests/seeded_faults.py --all            # a fault that its room's tests miss meets the whole default suite

Each fault is one wrong line of physics, statistics or input: a sign, a factor, an index, an axis, a root. A fault that
no test sees is a hole in the tests: write the test that sees it, do not drop the fault. The table of faults is
`seeded_faults.toml`; `old` must stand exactly once in its file, so that a fault never goes stale unnoticed.
"""

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
import time
import tomllib
from dataclasses import dataclass
from pathlib import Path


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
        return failing(copy, fault.tests) or (failing(copy, ("-n", "2")) if everything else None)
    finally:
        (copy / "memsgyro_jax" / fault.file).write_text(right)


def failing(copy: Path, arguments: tuple[str, ...]) -> str | None:
    """The first test that fails in the copy."""
    command = [sys.executable, "-m", "pytest", "-x", "-q", "-p", "no:cacheprovider", *arguments]
    environment = {**os.environ, "PYTHONPATH": str(copy), "PYTHONDONTWRITEBYTECODE": "1"}
    try:
        ran = subprocess.run(
            command, cwd=copy, env=environment, capture_output=True, text=True, timeout=LIMIT, check=False
        )
    except subprocess.TimeoutExpired:
        return f"no end after {LIMIT:.0f} s"
    if ran.returncode == 0:
        return None
    named = [line for line in ran.stdout.splitlines() if line.startswith(("FAILED", "ERROR"))]
    return named[0].split(" - ")[0] if ran.returncode == SEEN and named else f"pytest ended with {ran.returncode}"


if __name__ == "__main__":
    main()
