"""What `memsgyro check` does: read a measurement case, say what it holds, how good it is, and what it can identify."""

from pathlib import Path

from memsgyro_jax.diagnosis.identifiable import identifiable
from memsgyro_jax.measurement.case import assess, load_case


def run(folder: Path) -> None:
    """Print the records of the case, their quality, and how well each would hold the base parameters."""
    case = load_case(folder)
    for part in (case, assess(case)):
        print(part, end="\n\n", flush=True)
    print("What the fitted records can identify of the base model, by the size of one standard deviation:")
    for line in identifiable(case):
        print(f"  {line}")
