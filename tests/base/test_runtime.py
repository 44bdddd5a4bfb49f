"""`runtime.configure` in processes of their own, because JAX reads its settings once."""

import json
import os
from importlib.metadata import version
from pathlib import Path

import jax
import pytest

from memsgyro_jax import InputError
from memsgyro_jax.base import runtime


pytestmark = pytest.mark.smoke

REPORT = """
import json, os, sys
from memsgyro_jax import runtime
{before}
before = os.environ.get("XLA_FLAGS", "").split()
runtime.configure({arguments})
lean = "jax" not in sys.modules
import jax, jax.numpy as jnp
print(json.dumps(dict(
    lean=lean, before=before, flags=os.environ["XLA_FLAGS"].split(), devices=jax.device_count(),
    dtype=str(jnp.ones(1).dtype), cache=jax.config.jax_compilation_cache_dir,
)))
"""


@pytest.fixture
def report(fresh_python):
    def run(arguments="", before="", **environment):
        done = fresh_python("-c", REPORT.format(arguments=arguments, before=before), **environment)
        assert done.returncode == 0, done.stderr
        return json.loads(done.stdout)

    return run


def test_first_start_sets_everything_without_importing_jax(report):
    seen = report()
    assert seen["lean"]
    assert seen["dtype"] == "float64"
    assert seen["devices"] == len(os.sched_getaffinity(0)) == runtime.usable_cores()
    assert "--xla_cpu_prefer_vector_width=512" in seen["flags"]
    whole = version("jaxlib") not in runtime._FUSE_ONE_OUTPUT
    assert any("xla_cpu_use_multi_output_fusion=true" in flag for flag in seen["flags"]) == whole
    assert seen["cache"].endswith("compiled")


def test_jax_may_be_imported_before(report):
    seen = report("devices=3", before="import jax")
    assert seen["devices"] == 3
    assert seen["dtype"] == "float64"
    assert seen["cache"].endswith("compiled")


def test_second_call_changes_nothing(report):
    seen = report("devices=2", before="runtime.configure(devices=2)")
    assert seen["before"] == seen["flags"]


def test_settings_of_the_user_stay(report, tmp_path):
    theirs = ["--xla_cpu_prefer_vector_width=256", "--xla_force_host_platform_device_count=3"]
    seen = report(XLA_FLAGS=" ".join(theirs), JAX_COMPILATION_CACHE_DIR=str(tmp_path / "mine"))
    assert seen["flags"][:2] == theirs
    ours = [flag.split("=")[0] for flag in seen["flags"][2:]]
    assert "--xla_backend_extra_options" in ours
    if_known = {"--xla_cpu_experimental_ynn_fusion_type", "--xla_cpu_use_fusion_emitters"}
    assert set(ours) <= {"--xla_backend_extra_options", *if_known}
    assert seen["devices"] == 3
    assert seen["cache"] == str(tmp_path / "mine")


def test_a_file_of_flags_is_left_alone(fresh_python, tmp_path):
    (tmp_path / "flags.txt").write_text("--xla_force_host_platform_device_count=3\n")
    code = "from memsgyro_jax import runtime; runtime.configure(); import jax, os; print(jax.device_count())"
    done = fresh_python("-c", code, XLA_FLAGS=str(tmp_path / "flags.txt"))
    assert done.stdout == "3\n", done.stderr


def test_a_jaxlib_that_ends_the_process_with_an_option_is_not_given_it(monkeypatch):
    monkeypatch.setattr(runtime, "version", lambda name: "0.11.2")
    monkeypatch.delenv("JAX_PLATFORMS", raising=False)
    flags = " ".join(runtime._missing_flags("", 2))
    assert "multi_output_fusion" not in flags
    assert "xla_cpu_disable_loop_unrolling=true" in flags


UNTRIED = "runtime._TRIED = {}"
# One flag that every jaxlib knows and one that none does: each flag beside a wrong one costs the probe a process.
WRONG = f'{UNTRIED}; runtime._CPU_FLAGS = ("--xla_cpu_prefer_vector_width=512", "--xla_no_such_flag=1")'


@pytest.mark.slow
def test_a_flag_this_jaxlib_does_not_know_is_left_out_and_not_asked_for_again(report):
    """Nor by a second call, after JAX has started."""
    seen = report("devices=2", before=f"{WRONG}\nruntime.configure(devices=2); import jax; jax.devices()")
    assert "--xla_cpu_prefer_vector_width=512" in seen["flags"]
    assert "--xla_no_such_flag=1" not in seen["flags"]
    assert seen["devices"] == 2


@pytest.mark.slow
def test_an_option_of_the_compiler_that_it_does_not_know_is_left_out(report):
    name = "--xla_backend_extra_options"
    listed = f'runtime._CPU_FLAGS = ("{name}=xla_cpu_disable_loop_unrolling=true,-no-such=1",)'
    seen = report("devices=2", before=f"{UNTRIED}; {listed}")
    assert f"{name}=xla_cpu_disable_loop_unrolling=true" in seen["flags"]


@pytest.mark.parametrize(("platforms", "wanted"), [("", 5), ("cpu", 5), ("cuda,cpu", 5), ("cuda", 0)])
def test_flags_of_the_cpu_are_for_the_cpu(monkeypatch, platforms, wanted):
    monkeypatch.setenv("JAX_PLATFORMS", platforms)
    assert len(runtime._missing_flags("", devices=2)) == wanted


@pytest.mark.slow
def test_the_probe_runs_once_and_not_for_a_jaxlib_that_was_tried(report):
    first = report("devices=2", before=UNTRIED)
    unasked = "runtime._starts_with = None"  # a probe would fail on None
    assert report("devices=2", before=f"{UNTRIED}; {unasked}")["flags"] == first["flags"]
    if version("jaxlib") in runtime._TRIED:
        assert report("devices=2", before=unasked)["flags"] == first["flags"]


def test_nothing_is_written_without_a_cache(report, tmp_path):
    seen = report("devices=2", MEMSGYRO_NO_CACHE="1")
    assert seen["devices"] == 2
    assert seen["cache"] is None
    assert not (tmp_path / "cache").exists()


def test_an_unwritable_cache_is_no_error(report, tmp_path):
    (tmp_path / "cache").write_text("a file where the directory should go")
    assert report("devices=2")["devices"] == 2


def test_a_second_start_compiles_nothing(fresh_python):
    """Neither the functions nor the single operations outside them."""
    code = """
from memsgyro_jax import runtime
runtime.configure(devices=2)
import jax, jax.numpy as jnp
events = []
jax.monitoring.register_event_listener(lambda event, **_: events.append(event.rpartition("compilation_cache/")[2]))
jax.jit(lambda x: jax.lax.scan(lambda c, _: (jnp.sin(jnp.linalg.solve(x + c, x)), None), x, length=9)[0])(jnp.eye(3))
print(events.count("compile_requests_use_cache"), events.count("cache_hits"))
"""
    first, second = (fresh_python("-c", code) for _ in range(2))
    assert first.returncode == 0, first.stderr
    requests, hits = map(int, first.stdout.split())
    assert requests > 1
    assert hits == 0
    assert second.stdout == f"{requests} {requests}\n", second.stderr


@pytest.mark.parametrize(
    ("before", "arguments", "environment", "names"),
    [
        ("", "devices=0", {}, "`devices` must be at least 1"),
        ("", "devices=2", {"XLA_FLAGS": "--xla_force_host_platform_device_count=3"}, "XLA_FLAGS"),
        ("", "", {"JAX_ENABLE_X64": "0"}, "JAX_ENABLE_X64"),
        ("import jax; jax.devices()", "", {}, "must be called before JAX"),
    ],
)
def test_what_cannot_be_done_is_one_sentence(fresh_python, before, arguments, environment, names):
    code = f"""
from memsgyro_jax import InputError, runtime
{before}
try:
    runtime.configure({arguments})
except InputError as error:
    print(error)
"""
    done = fresh_python("-c", code, **environment)
    assert done.returncode == 0, done.stderr
    assert names in done.stdout
    assert done.stdout.count("\n") == 1


def test_float32_is_refused_where_float64_is_needed():
    runtime.require_float64("`simulate`")
    with jax.enable_x64(False), pytest.raises(InputError, match=r"^`simulate` must run in float64, but .*float32"):
        runtime.require_float64("`simulate`")


ROOM = """
import jax
from memsgyro_jax import runtime
once = jax.jit(lambda x: x + 1.0)
once(1.0)
assert not runtime.make_room(most=1.0)
assert once._cache_size() == 1
assert runtime.make_room(most=0.0)
assert once._cache_size() == 0
assert once(1.0) == 2.0
print("room was made")
"""


@pytest.mark.skipif(not Path("/proc/self/maps").exists(), reason="Linux alone counts memory maps")
def test_room_is_made_for_programs(fresh_python):
    """A process that diagnosed case after case ended in the thirty-fifth, as its compiled programs filled all maps."""
    done = fresh_python("-c", ROOM)  # here it would take from all other tests what they have compiled
    assert done.stdout == "room was made\n", done.stderr
