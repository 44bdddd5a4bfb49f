"""Sets JAX up before any test module imports it, and offers what many tests share."""

import gc
import os
from importlib.metadata import version

from memsgyro_jax.base import runtime


os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # NumPy's threads would wait for work on the other workers' cores
if version("jaxlib") in runtime._TRIED and "XLA_FLAGS" not in os.environ:  # likewise XLA's; others may not know
    os.environ["XLA_FLAGS"] = "--xla_cpu_parallel_codegen_split_count=1"
runtime.configure(devices=2)
gc.set_threshold(200_000, 20, 100)  # what is imported and compiled stays: few collections need to look at it

import subprocess  # noqa: E402
import sys  # noqa: E402
from collections.abc import Callable  # noqa: E402
from pathlib import Path  # noqa: E402
from typing import Any  # noqa: E402

import hypothesis  # noqa: E402
import jax  # noqa: E402
import pytest  # noqa: E402


jax.config.update("jax_traceback_in_locations_limit", 1)  # whence an operation is called: no test asks, and it costs

# The first example of a property compiles, the others do not: a deadline per example would measure the compiler.
hypothesis.settings.register_profile("memsgyro", deadline=None, derandomize=True, print_blob=True)
hypothesis.settings.load_profile("memsgyro")

ROOT = Path(__file__).resolve().parent.parent
SETTINGS = ("XLA_FLAGS", "JAX_", "MEMSGYRO_")
# The files that take longest, most of it to compile. Workers begin with them: one begun last would leave others idle.
LONGEST = (
    "app/report/test_diagnosis_page.py",
    "montecarlo/test_sweep.py",
    "diagnosis/test_diagnose.py",
    "effects/test_members.py",
    "app/test_commands.py",
    "tuning/test_tune.py",
    "loop/test_effects_in_loop.py",
    "motion/test_design_motion.py",
    "couplings/test_identify.py",
    "loop/observers/test_ekf.py",
    "diagnosis/test_joint_residual.py",
    "diagnosis/test_instrument.py",
    "measurement/experiments/test_free_decay.py",
    "loop/controllers/test_classic.py",
    "measurement/test_thinning.py",
    "measurement/test_allan.py",
    "diagnosis/test_moved.py",
    "loop/test_trace.py",
    "loop/test_blocks.py",
    "loop/test_bound.py",
    "montecarlo/test_sensitivity.py",
    "test_typing.py",
    "measurement/test_datasheet.py",
    "device/test_propagate.py",
    "effects/test_settled.py",
    "diagnosis/test_identifiable.py",
    "base/test_runtime.py",
    "measurement/case/test_quality.py",
    "app/report/test_sweep_page.py",
    "loop/test_further.py",
    "couplings/test_tree_fit.py",
    "measurement/test_import_case.py",
    "montecarlo/test_lots.py",
    "app/test_fit_command.py",
    "couplings/test_modal.py",
    "lab/test_laboratory.py",
    "diagnosis/test_further_numbers.py",
    "measurement/test_held_noise.py",
    "loop/test_linearised.py",
    "diagnosis/test_law.py",
    "montecarlo/test_farm.py",
    "app/test_identify_command.py",
    "loop/test_output_filter.py",
    "diagnosis/test_decays_apart.py",
    "test_cantilever.py",
    "test_readme.py",
    "measurement/experiments/test_operating_points.py",
    "measurement/test_harmonic_slopes.py",
    "effects/test_units.py",
    "effects/test_of_operation.py",
)


# Files that one worker runs one after the other, as what they share is then done once.
TOGETHER = (
    ("montecarlo/test_sweep.py", "test_readme.py"),  # the default sweep
    ("app/test_commands.py", "app/report/test_sweep_page.py", "app/test_surroundings.py"),  # a small one
    ("measurement/test_experiments_of_models.py", "diagnosis/test_joint_residual.py"),  # the default `bench`
    ("couplings/test_identify.py", "app/test_identify_command.py"),  # the fit to a wide sweep
    (  # the demonstration's fit
        "app/report/test_diagnosis_page.py",
        "diagnosis/test_residual_force.py",
        "diagnosis/test_compare.py",
        "app/test_fit_command.py",
    ),
)


# What promises bits, or almost, is tested in the code that users run, and so are slow tests and processes of their own.
# The others ask for figures: their programs run once, and compile faster without LLVM's optimiser.
OPTIMISED = (
    "montecarlo/test_sweep.py",
    "effects/test_members.py",
    "effects/test_of_operation.py",
    "couplings/test_frequency_sweep.py",
    "loop/test_effects_in_loop.py",
    "loop/test_brownian.py",
    "loop/test_flicker.py",
    "loop/test_loop.py",
    "loop/test_trace.py",
    "tuning/test_adjoint.py",
    "test_readme.py",  # runs long enough to be worth it
)


def _place(item: pytest.Item) -> str:
    """A test's file within this folder; nothing for one of elsewhere."""
    folder = ROOT / "tests"
    return item.path.relative_to(folder).as_posix() if item.path.is_relative_to(folder) else ""


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_setup(item: pytest.Item) -> None:
    """Says how the programs of this test are compiled, and forgets those of other tests that are not like it."""
    wanted = _place(item).startswith(OPTIMISED) or item.get_closest_marker("slow") is not None
    if wanted and jax.config.read("jax_disable_most_optimizations"):
        jax.clear_caches()
    jax.config.update("jax_disable_most_optimizations", not wanted)


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> Any:
    """A file stays with one worker, and so do the files of `TOGETHER`."""
    from xdist.scheduler import LoadFileScheduling

    class Scheduling(LoadFileScheduling):
        def _split_scope(self, nodeid: str) -> str:
            file = super()._split_scope(nodeid)
            return next((" ".join(group) for group in TOGETHER if file.removeprefix("tests/") in group), file)

    return Scheduling(config, log)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Longest files first, behind those of optimised programs. What was imported is not looked at again."""
    order = {name: number for number, name in enumerate(LONGEST)}
    items.sort(key=lambda item: (not _place(item).startswith(OPTIMISED), order.get(_place(item), len(LONGEST))))
    gc.freeze()


@pytest.fixture(scope="session")
def root() -> Path:
    """The repository."""
    return ROOT


@pytest.fixture(scope="session")
def shared() -> Path:
    """Measured and published material that is not part of the repository; tests that use it are extra."""
    path = ROOT.parent / "shared"
    if not path.is_dir():
        pytest.skip("no folder `shared` beside the repository")
    return path


@pytest.fixture
def quick_pictures(monkeypatch: pytest.MonkeyPatch) -> None:
    """Pictures of pages are drawn once, without the search for their margins, which is most of a page's time: for tests
    of what stands beside them. Pages that fixtures of a module make are drawn as users see them.
    """
    from matplotlib.backends.backend_svg import FigureCanvasSVG
    from matplotlib.figure import Figure

    whole = Figure.savefig

    def savefig(figure: Figure, file: Any, *arguments: Any, bbox_inches: Any = None, **named: Any) -> None:
        figure.set_layout_engine("none")
        if named.get("format") == "svg":  # which `savefig` draws twice, the first time for a layout
            FigureCanvasSVG(figure).print_svg(file, metadata=named.get("metadata"))
        else:
            whole(figure, file, *arguments, **named)

    monkeypatch.setattr(Figure, "savefig", savefig)


@pytest.fixture
def no_pictures(monkeypatch: pytest.MonkeyPatch) -> None:
    """Pages stand without their pictures, which are made but not drawn: for tests of the words alone."""
    from matplotlib.figure import Figure

    monkeypatch.setattr(Figure, "savefig", lambda figure, file, *_, **__: file.write("<svg></svg>"))


@pytest.fixture
def fresh_python(tmp_path: Path) -> Callable[..., subprocess.CompletedProcess[str]]:
    """Runs `python *arguments` as a user's first start would: no setting of this process, empty cache, empty folder.

    Keyword arguments are environment variables. Both folders last as long as the test: a second start finds the cache.
    """

    def run(*arguments: str, **environment: str) -> subprocess.CompletedProcess[str]:
        clean = {name: value for name, value in os.environ.items() if not name.startswith(SETTINGS)}
        clean |= {"XDG_CACHE_HOME": str(tmp_path / "cache"), "PYTHONPATH": str(ROOT), **environment}
        return subprocess.run(
            [sys.executable, *arguments], env=clean, cwd=tmp_path, capture_output=True, text=True, check=False
        )

    return run
