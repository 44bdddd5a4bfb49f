"""What `memsgyro check` does: read a measurement case, say what it holds and how good it is."""

from pathlib import Path

from .case import assess, load_case


def run(folder: Path) -> None:
    """Print the records of the case and their quality."""
    case = load_case(folder)
    for part in (case, assess(case)):
        print(part, end="\n\n")
