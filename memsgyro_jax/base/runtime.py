"""How JAX is set up before it starts: float64, compiler options, host devices and the cache of compiled programs.

Only entry points (the command line, studies, the tests) call `configure`. The library itself changes no global setting
of JAX; what needs double precision says so through `require_float64`.
"""

import contextlib
import hashlib
import logging
import os
import platform
import subprocess
import sys
from importlib.metadata import version
from pathlib import Path

from .errors import InputError
from .files import write_whole


# Undocumented options that let XLA's CPU compiler keep a small, long-running loop in one vectorised function; the last
# is LLVM's, which otherwise leaves loops with many inputs and results scalar. An unknown name of XLA's behind
# `--xla_backend_extra_options` is ignored, one of LLVM's or in XLA_FLAGS itself ends the process: see `_known`.
MANY_OUTPUTS = "xla_cpu_use_multi_output_fusion=true"
_EXTRA_OPTIONS = (
    MANY_OUTPUTS,
    "xla_cpu_small_while_loop_byte_threshold=100000000",
    "xla_cpu_disable_loop_unrolling=true",
    "-vectorize-memory-check-threshold=1000",
)
_CPU_FLAGS = (
    "--xla_cpu_prefer_vector_width=512",
    f"--xla_backend_extra_options={','.join(_EXTRA_OPTIONS)}",
    # Sums over products are not handed to a library, which took the small and complex ones here with all that makes
    # them up: captures and driven sweeps took twice as long.
    "--xla_cpu_experimental_ynn_fusion_type=",
    # The dozens of small kernels around a loop compile in half the time without a pass through MLIR. Gone from jaxlib
    # 0.12, with which a first sweep takes about as long.
    "--xla_cpu_use_fusion_emitters=false",
)
# With `MANY_OUTPUTS` these end the process at some programs ("Check failed: GetNumDims() == other.GetNumResults()").
_FUSE_ONE_OUTPUT = {"0.11.1", "0.11.2"}
_TRIED = {"0.10.2": _CPU_FLAGS, "0.12.0.1": _CPU_FLAGS[:3]}  # what a jaxlib is known to take
_DEVICES_FLAG = "--xla_force_host_platform_device_count"
_LOG = logging.getLogger("memsgyro_jax")
_PROBE = "import jax; jax.jit(abs)(1.0)"  # LLVM reads its options when it compiles


def configure(devices: int | None = None) -> None:
    """Prepares JAX for this package; call it first in an entry point, before JAX computes anything.

    Switches float64 on, adds compiler options to `XLA_FLAGS` and points JAX to a cache of compiled programs in the
    user's cache directory; NumPy, unless it is imported already, computes on one thread. What the user has set in the
    environment stays: a flag already in `XLA_FLAGS`, `JAX_COMPILATION_CACHE_DIR`, `JAX_PLATFORMS`,
    `OPENBLAS_NUM_THREADS`. With `MEMSGYRO_NO_CACHE` set to anything but `0` nothing is written to the cache directory.
    A second call with the same meaning does nothing.

    The CPU is divided into `devices` host devices, at least 1; `None` means one for each usable core.

    Raises `InputError` if `devices` is below 1 or contradicts `XLA_FLAGS`, if `JAX_ENABLE_X64` asks for float32, or if
    JAX has started without these settings.
    """
    count = usable_cores() if devices is None else devices
    if count < 1:
        raise InputError(f"Argument `devices` must be at least 1, but is {count}.")
    if os.environ.get("JAX_ENABLE_X64", "1").lower() in {"0", "false", "off", "no", "n", "f"}:
        raise InputError("Environment variable JAX_ENABLE_X64 must be unset or 1, but it asks for float32.")
    present = os.environ.get("XLA_FLAGS", "").strip()
    missing = _missing_flags(present, count)
    if devices is not None and f"{_DEVICES_FLAG}=" in present and f"{_DEVICES_FLAG}={devices}" not in present.split():
        raise InputError(
            f"Argument `devices` must agree with {_DEVICES_FLAG} in the environment variable XLA_FLAGS where both are "
            f"given, but is {devices}; leave one of them out."
        )
    # NumPy's products and decompositions here are small: its threads would mostly wait, which costs a core each.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    missing = _known(missing) if missing else []  # what this jaxlib does not know was left out by the first call too
    if missing and _backend_started():
        raise InputError(
            "`memsgyro_jax.runtime.configure()` must be called before JAX computes anything, but JAX has started "
            "already; move the call to the top of the script. In a notebook restart the kernel, and run `from "
            "memsgyro_jax import runtime; runtime.configure()` as its first cell."
        )
    if missing:
        os.environ["XLA_FLAGS"] = " ".join([present, *missing]).strip()
    _set("jax_enable_x64", True)
    _enable_cache()
    _LOG.debug("float64, %d host devices, compiled programs kept in %s", count, cache_directory() or "no folder")


def require_float64(who: str) -> None:
    """Refuses to go on in single precision, where covariances lose positive definiteness within half a second.

    `who` needs float64, as the subject of the sentence, e.g. ``"`simulate`"``; raises `InputError` if it is off.
    """
    import jax

    if not jax.config.read("jax_enable_x64"):
        raise InputError(
            f"{who} must run in float64, but JAX is set to float32; run `from memsgyro_jax import runtime; "
            "runtime.configure()` at the top of the script. In a notebook restart the kernel, and run it as the first "
            'cell; or go on with `jax.config.update("jax_enable_x64", True)`, and make every object again.'
        )


def usable_cores() -> int:
    """Number of cores this process may use (its affinity mask where the system has one), at least 1."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def cache_directory() -> Path | None:
    """Directory for compiled programs and the probe's answer, or `None` where none is wanted (`MEMSGYRO_NO_CACHE`) or
    the user has no home.

    It is divided by jaxlib version and by processor, because a compiled program holds instructions of the machine that
    made it and home directories are shared between the nodes of a cluster.
    """
    if os.environ.get("MEMSGYRO_NO_CACHE", "0") != "0":
        return None
    from platformdirs import user_cache_path

    try:
        cache = user_cache_path("memsgyro_jax")
    except RuntimeError:  # no home is known; earlier versions give a path below `~`, which would be a folder here
        return None
    return cache / f"jaxlib-{version('jaxlib')}-{processor()}" if cache.is_absolute() else None


def make_room(most: float = 0.5) -> bool:
    """Lets go of compiled programs where they take more than a part `most` of the memory maps that Linux allows a
    process; returns whether it did.

    Each of them stays mapped, and a diagnosis makes some hundred: past the limit LLVM ends the process, after some
    twenty-five cases. Those that are asked for again come from the cache on disk, where there is one.
    """
    try:
        allowed = int(Path("/proc/sys/vm/max_map_count").read_text())
        taken = Path("/proc/self/maps").read_bytes().count(b"\n")
    except (OSError, ValueError):  # another system
        return False
    if taken <= most * allowed:
        return False
    import jax

    jax.clear_caches()
    return True


def _missing_flags(present: str, devices: int) -> list[str]:
    """The flags this package wants and the user has not set, to any value."""
    if not _cpu_may_be_used() or (present and not present.startswith("-")):  # XLA_FLAGS may also name a file of flags
        return []
    ours: tuple[str, ...] = _CPU_FLAGS
    if version("jaxlib") in _FUSE_ONE_OUTPUT:
        ours = tuple(flag.replace(f"{MANY_OUTPUTS},", "") for flag in ours)
    wanted = [*ours, f"{_DEVICES_FLAG}={devices}"]
    names = {flag.split("=")[0] for flag in present.split()}
    return [flag for flag in wanted if flag.split("=")[0] not in names]


def _cpu_may_be_used() -> bool:
    platforms = os.environ.get("JAX_PLATFORMS", "").lower()
    return platforms == "" or "cpu" in platforms.split(",")


def _backend_started() -> bool:
    """Whether JAX has created its devices, after which XLA_FLAGS has no effect."""
    if "jax" not in sys.modules:
        return False
    from jax._src.xla_bridge import backends_are_initialized  # not public; the public ways to ask start the devices

    return backends_are_initialized()


def _known(flags: list[str]) -> list[str]:
    """Those of `flags` with which this jaxlib starts: tried once in a process of its own, then remembered."""
    tried = _TRIED.get(version("jaxlib"))
    if tried and all(flag in _CPU_FLAGS or flag.startswith(_DEVICES_FLAG) for flag in flags):
        return [flag for flag in flags if flag in tried or flag.startswith(_DEVICES_FLAG)]
    directory = cache_directory()
    asked = hashlib.sha256(" ".join(flags).encode()).hexdigest()[:12]
    answer = directory / f"flags-{asked}" if directory else None
    with contextlib.suppress(OSError, ValueError):
        if answer:
            return answer.read_text().split()
    known = flags if _starts_with(flags) else [part for flag in flags if (part := _known_part(flag))]
    if answer:
        with contextlib.suppress(OSError):  # a cache that cannot be written only costs the next start a probe
            answer.parent.mkdir(parents=True, exist_ok=True)
            write_whole(answer, "\n".join(known))
    return known


def _known_part(flag: str) -> str:
    """`flag` if this jaxlib starts with it; of a list of options those with which it starts; or nothing."""
    if _starts_with([flag]):
        return flag
    name, _, options = flag.partition("=")
    known = [option for option in options.split(",") if "," in options and _starts_with([f"{name}={option}"])]
    return f"{name}={','.join(known)}" if known else ""


def _starts_with(flags: list[str]) -> bool:
    alone = {"XLA_FLAGS": " ".join(flags), "JAX_PLATFORMS": "cpu", "JAX_ENABLE_COMPILATION_CACHE": "0"}
    probe = [sys.executable, "-c", _PROBE]
    return subprocess.run(probe, env={**os.environ, **alone}, capture_output=True, check=False).returncode == 0


def _enable_cache() -> None:
    directory = cache_directory()
    if directory is None:
        return
    if "JAX_COMPILATION_CACHE_DIR" not in os.environ:
        compiled = directory / "compiled"
        with contextlib.suppress(OSError):
            compiled.mkdir(parents=True, exist_ok=True)
        if not os.access(compiled, os.W_OK):  # JAX would warn at every program that it cannot store
            return
        _set("jax_compilation_cache_dir", str(compiled))
    if "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS" not in os.environ:
        # Small programs too: what JAX computes outside a compiled function is one of them each, and a start has dozens.
        _set("jax_persistent_cache_min_compile_time_secs", 0.0)


def _set(name: str, value: bool | float | str) -> None:
    """Sets an option of JAX, through the environment while JAX is not imported yet (importing it takes a second)."""
    if "jax" in sys.modules:
        import jax

        jax.config.update(name, value)
    else:
        os.environ[name.upper()] = str(value)


def processor() -> str:
    """Digits that tell kinds of processors apart, by the instructions they know: between them last bits may differ."""
    return hashlib.sha256(f"{platform.machine()} {_processor_features()}".encode()).hexdigest()[:12]


def _processor_features() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return platform.processor()
    return next((line for line in lines if line.startswith(("flags", "Features"))), "")
