"""`memsgyro sweep` and `memsgyro simulate` as a user runs them: what they leave behind, and what they refuse."""

import json
import os
import resource
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from harness import PERCENTILES

import memsgyro_jax as mg
from memsgyro_jax.app import cli


SMALL = ["--dies", "5", "--sample-rate", "20e3", "--duration", "0.01", "--chunk", "2"]
RUN = ["--sample-rate", "20 kHz", "--duration", "0.01"]
RECORD = "t [s],rate [deg/s]\n0,0\n0.005,60\n0.01,-30\n"


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture
def memsgyro(folder, capsys, quick_pictures):
    """Runs the command line in an empty folder: exit status, standard output, standard error."""

    def run(*tokens):
        with pytest.raises(SystemExit) as end:
            cli.main(list(map(str, tokens)))
        return end.value.code, *capsys.readouterr()

    return run


@pytest.fixture(scope="module")
def swept(tmp_path_factory):
    """Folder of a small sweep's results."""
    place = tmp_path_factory.mktemp("swept") / "sweep-out"
    with pytest.raises(SystemExit) as end:
        cli.main(["sweep", *SMALL, "--out", str(place)])
    assert end.value.code == 0
    return place


@pytest.fixture
def started(swept, folder):
    """The results lie where the next sweep would put its own."""
    return shutil.copytree(swept, folder / "sweep-out")


def load(path):
    return json.loads(Path(path).read_text())


def content(folder):
    """Every file below a folder with its bytes."""
    return {path.relative_to(folder): path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file()}


def test_a_sweep_in_parts_is_the_sweep(memsgyro, folder, swept):
    status, out, _ = memsgyro("sweep", *SMALL, "--part", "1/2")  # all five dies are in one block, the second part's
    assert (status, out.count("no dies in this part"), out.count("0 of 5 (0.0 %)")) == (0, 1, 1)
    assert {path.name for path in (folder / "sweep-out").iterdir()} == {"dies.zarr"}
    status, out, _ = memsgyro("sweep", *SMALL, "--part", "2/2")
    assert (status, out.count("5 of 5 dies computed"), out.count("yield (95 % interval)")) == (0, 1, 1)
    assert content(folder / "sweep-out" / "dies.zarr") == content(swept / "dies.zarr")
    parts, whole = load("sweep-out/summary.json"), load(swept / "summary.json")
    assert {**parts, "steps_per_s": None} == {**whole, "steps_per_s": None}
    status, out, _ = memsgyro("status")
    assert (status, " ".join(out.split())) == (0, "dies done 5 of 5 (100 %): 0 lost, 0 diverged at work nobody")
    for tokens in (
        ["--part", "3/2"],
        ["--part", "two"],
        ["--part", "1/1", "--overwrite"],
        ["--part", "1/1", "--dask", "x"],
    ):
        status, _, said = memsgyro("sweep", *SMALL, *tokens)
        assert (status, said.count("\n"), "`" in said) == (2, 1, True), said
    status, _, said = memsgyro("status", "nowhere")
    assert (status, "but there is none; give the folder that the sweep has" in said) == (2, True)


def test_a_sweep_prints_its_table_and_leaves_three_results(memsgyro, folder):
    status, out, said = memsgyro("sweep", *SMALL)
    assert status == 0, said
    assert "yield (95 % interval)" in out
    assert "information bound" in out
    assert "5 of 5 dies" in said
    assert {path.name for path in (folder / "sweep-out").iterdir()} == {"dies.zarr", "summary.json", "report.html"}
    summary = load("sweep-out/summary.json")
    assert summary["schema"] == "memsgyro-sweep/1"
    wanted = {"dies", "failed", "rate_error_dps", "bound_dps", "ratio_to_bound", "nees", "convergence_time_s", "yield"}
    assert wanted | {"steps_per_s", "seed", "versions"} <= set(summary)
    assert set(summary["yield"]) == {"value", "low", "high", "criterion"}
    for part in ("end", "settled"):
        assert set(summary["rate_error_dps"][part]) == PERCENTILES
    assert (summary["dies"], summary["failed"], summary["seed"]) == (5, 0, 0)
    with xr.open_zarr(folder / "sweep-out" / "dies.zarr", consolidated=False) as data:
        error = np.degrees(data["rate_error_end"].values)
    assert error.shape == (5,)
    assert summary["rate_error_dps"]["end"]["rms"] == pytest.approx(np.sqrt(np.mean(error**2)), rel=1e-12)


def test_what_is_told_before_a_sweep_is_not_told_again(memsgyro, folder, monkeypatch, caplog):
    monkeypatch.setattr("memsgyro_jax.montecarlo.parts.unexpected", lambda *given: ("The rate moves.",))
    status, out, _ = memsgyro("sweep", *SMALL)
    assert (status, [told.message for told in caplog.records]) == (0, ["The rate moves."])
    assert "The rate moves." not in out
    assert load("sweep-out/summary.json")["notes"] == ["The rate moves."]
    assert "The rate moves." in (folder / "sweep-out" / "report.html").read_text()


def test_a_sweep_is_that_of_its_study(memsgyro, folder):
    changes = {"sweep.sample_rate": "20 kHz", "sweep.duration": "10 ms", "sweep.dies": 5, "sweep.chunk": 2}
    mg.default_study().changed(changes).write("my.toml")
    assert memsgyro("sweep", "my.toml", "--seed", 4, "--json", "copy.json")[0] == 0
    study = mg.load_study("my.toml").changed({"sweep.seed": 4})
    wanted = mg.sweep(**study.sweep_arguments).to_xarray()
    with xr.open_zarr("sweep-out/dies.zarr", consolidated=False) as found:
        np.testing.assert_array_equal(found["rate_error_end"], wanted["rate_error_end"])
    assert (folder / "copy.json").read_bytes() == (folder / "sweep-out" / "summary.json").read_bytes()


@pytest.mark.usefixtures("started")
def test_resume_goes_on_and_overwrite_starts_again(memsgyro):
    status, _, said = memsgyro("sweep", *SMALL)
    assert status == 2
    assert "`--resume` to go on with it, `--overwrite` to replace it" in said
    assert memsgyro("sweep", *SMALL[2:], "--dies", 7, "--resume")[0] == 0
    assert load("sweep-out/summary.json")["dies"] == 7
    assert memsgyro("sweep", *SMALL, "--overwrite")[0] == 0
    assert load("sweep-out/summary.json")["dies"] == 5


@pytest.mark.usefixtures("started")
@pytest.mark.parametrize("change", [["--seed", "1"], ["--duration", "0.02"], ["--chunk", "3"]])
def test_a_store_of_another_configuration_is_kept_and_refused(memsgyro, folder, change):
    before = content(folder)
    given = dict(zip(SMALL[::2], SMALL[1::2], strict=True)) | {change[0]: change[1]}
    status, _, said = memsgyro("sweep", *(word for pair in given.items() for word in pair), "--resume")
    assert status == 2
    assert "dies.zarr" in said
    assert said.count("\n") == 1
    assert content(folder) == before


@pytest.mark.slow
def test_a_recorded_rate_is_followed(memsgyro, folder):
    time = np.linspace(0.0, 0.06, 121)
    rows = [f"{t:.6f},{3.0 * np.sin(2 * np.pi * 30.0 * t):.6f}" for t in time]
    (folder / "turn.csv").write_text("\n".join(["t [s],rate [rad/s]", *rows, ""]))
    known = ["kxx", "kyy", "kxy", "dxx", "dyy", "dxy", "sigma"]  # a smaller filter compiles faster
    mg.default_study().changed({"observer.known": known}).write("small.toml")
    given = ("--dies", 3, "--sample-rate", "20e3", "--chunk", 2, "--rate-record", "turn.csv")
    status, out, said = memsgyro("sweep", "small.toml", *given)
    assert status == 0, said
    assert "as long as the record, 0.06 s" in out
    assert "varying rate followed" in out
    summary = load("sweep-out/summary.json")
    intervals = {"delay_interval_s", "bandwidth_interval_hz"}
    assert set(summary["following"]) == {"rms_dps", "delay_s", "bandwidth_hz", *intervals}
    assert summary["bound_dps"] is None, "the bound is that of a constant rate"
    with xr.open_zarr("sweep-out/dies.zarr", consolidated=False) as data:
        wanted = 3.0 * np.sin(2 * np.pi * 30.0 * data["time"].values)
        np.testing.assert_allclose(data["rate_true"].values[1], wanted, atol=0.02)


def test_a_run_prints_its_figures_and_leaves_its_results(memsgyro, folder):
    status, out, said = memsgyro("simulate", *RUN, "--out", "run", "--json", "run.json")
    assert (status, said) == (0, "")
    assert "rate error at the end" in out
    assert {path.name for path in (folder / "run").iterdir()} == {"trace.zarr", "summary.json", "report.html"}
    found = load("run.json")
    assert found["schema"] == "memsgyro-run/1"
    study = mg.default_study()
    trace = mg.simulate(study.loop, study.scenario, sample_rate=20e3, duration=0.01)
    assert found["rate_error_dps"]["end"] == pytest.approx(np.degrees(trace.rate_error[-1]), rel=1e-9)
    for read in (mg.load, xr.open_zarr):  # ours gives names and units, any other the numbers
        np.testing.assert_allclose(read("run/trace.zarr")["rate_estimate"], trace.rate_estimate, rtol=1e-9)
    assert memsgyro("simulate", *RUN, "--out", "run")[0] == 0, "a second run takes the place of the first"


def test_a_run_of_a_die_is_that_of_the_sweep(memsgyro, swept):
    assert memsgyro("simulate", *RUN, "--die", 3, "--json", "run.json")[0] == 0
    with xr.open_zarr(swept / "dies.zarr", consolidated=False) as data:
        wanted = np.degrees(float(data["rate_error_end"][3]))
    assert load("run.json")["rate_error_dps"]["end"] == pytest.approx(wanted, rel=1e-6)


def test_a_run_writes_nothing_unless_asked(memsgyro, folder):
    assert memsgyro("simulate", *RUN)[0] == 0
    assert content(folder) == {}


def test_a_lost_die_is_told(memsgyro):
    study = mg.load_study(mg.default_study().write("tight.toml"))  # in full: start and tone do not follow the travel
    study.changed({"loop.travel": "1.001 um"}).write("tight.toml")
    status, out, _ = memsgyro("simulate", "tight.toml", *RUN, "--json", "run.json")
    assert status == 0
    assert "lost at" in out
    status, out, said = memsgyro("sweep", "tight.toml", *SMALL)
    assert status == 0, said
    assert "5, of which 5 lost" in out
    assert load("sweep-out/summary.json")["failed"] == 5


STUDY = mg.default_study().to_toml()
CHANGED = [
    # (in the default study, replace, by, what the sentence must say)
    ("1.8e-07 kg", "-1.8e-07 kg", ["device.mass", "greater than 0"]),
    ("1.8e-07 kg", "1.8e-07 m", ["device.mass", '"kg"', '"m"']),
    ('"1.8e-07 kg"', "1.8e-07", ["device.mass", "must carry a unit"]),
    ('"1.8e-07 kg"', "nan", ["device.mass"]),
    ("kxy =", "kxyz =", ["device.kxyz", "did you mean `kxy`", "device.kxy`: is missing"]),
    ("[sweep]", "[sweeps]", ["`sweeps`", "did you mean `sweep`"]),
    ("12.78 N/m", "-80 N/m", ["stiffness matrix", "positive definite"]),
    ("3.6e-06 N", "-3.6e-06 N", ["damping matrix", "positive definite"]),
    ("100000.0 Hz", "6 kHz", ["sweep.sample_rate", "use at least"]),
    ("seed = 0", 'seed = 0\nsettle = "1 s"', ["sweep.settle", "shorter"]),
    ("[device]", "[device", ["TOML"]),
]
OPTIONS = [
    (["sweep", "none.toml"], ["none.toml", "no such study"]),
    (["simulate", "--sample-rate", "6000"], ["sweep.sample_rate", "use at least"]),
    (["simulate", "--sample-rate", "nan"], ["sweep.sample_rate", "finite"]),
    (["sweep", "--dies", "0"], ["sweep.dies", "1"]),
    (["sweep", "--block", "500"], ["loop.block", "power of two"]),
    (["simulate", "--block", "512", "--case", "bench"], ["--block", "--case"]),
    (["sweep", "--dies", "many"], ["--dies", "many"]),
    (["sweep", "--seed", "-1"], ["sweep.seed", "0"]),
    (["simulate", "--duration", "0"], ["sweep.duration", "greater than 0"]),
    (["simulate", "--duration", "1 kg"], ["sweep.duration", 'measure the same as "s"']),
    (["simulate", "--sample-rate", "fast"], ["sweep.sample_rate", "must be a number with a unit"]),
    (["simulate", "--duration", "1e-9"], ["duration", "at least one sample"]),
    (["simulate", "--die", "-1"], ["--die", "-1"]),
    (["sweep", "--resume", "--overwrite"], ["--resume", "--overwrite"]),
    (["sweep", "--rate-record", "none.csv"], ["none.csv", "no such file"]),
]
RECORDS = [
    ("60", "nan", ["line 3", "`rate`", "finite number"]),
    ("0.005", "0.02", ["line 4", "`t`", "later"]),
    (" [deg/s]", "", ["line 1, column 2", '"name [unit]"']),
    ("deg/s", "deg", ["`rate`", '"rad/s"', '"deg"']),
    ("0.005,60", "0,005,60", ["line 3", "decimal"]),
    (",60", "", ["line 3", "cut short"]),
]
BOTH = STUDY.replace("dies = 256", "dies = 8")
IN_STUDY = '[scenario]\nrate = { kind = "record", file = "r.csv" }\n'
REFUSED = [
    # (files, tokens, what the sentence must say)
    *(({"s.toml": STUDY.replace(old, new)}, ["sweep", "s.toml"], ["s.toml", *words]) for old, new, words in CHANGED),
    *(({}, tokens, words) for tokens, words in OPTIONS),
    *(({"r.csv": RECORD.replace(old, new)}, ["sweep", "--rate-record", "r.csv"], ["r.csv", *words])
      for old, new, words in RECORDS),
    ({"s.toml": IN_STUDY, "r.csv": RECORD.replace("60", "inf")}, ["sweep", "s.toml"], ["line 2", "r.csv, line 3"]),
    ({"s.toml": BOTH}, ["sweep", "s.toml", "--dies", "-4"], ["s.toml, changed: `sweep.dies`", "-4"]),
    ({"out": "mine"}, ["sweep", "--out", "out"], ["out", "no folder"]),
    ({"j/x": ""}, ["sweep", "--json", "j"], ["j must be a file"]),
    ({"sweep-out/dies.zarr/x": "mine"}, ["sweep", "--resume"], ["dies.zarr", "not the store"]),
]  # fmt: skip
NAMES = [f"{n}: {' '.join(words)[:40]}" for n, (_, _, words) in enumerate(REFUSED)]


def test_the_table_changes_what_it_says():
    assert all(STUDY.count(old) == 1 for old, _, _ in CHANGED)
    assert all(RECORD.count(old) == 1 for old, _, _ in RECORDS)


@pytest.mark.parametrize(("files", "tokens", "words"), REFUSED, ids=NAMES)
def test_what_cannot_be_used_is_one_sentence_and_leaves_nothing(memsgyro, folder, files, tokens, words):
    for name, text in files.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(text)
    before = content(folder)
    status, out, said = memsgyro(*tokens)
    assert (status, out) == (2, ""), said
    assert said.count("\n") == 1 + ("device.kxyz" in words), "a line for each of what is wrong"
    assert "Traceback" not in said
    for word in words:
        assert word in said, said
    assert content(folder) == before
    assert sorted(path.name for path in folder.iterdir()) == sorted({name.split("/")[0] for name in files})


def test_float32_by_accident(fresh_python, tmp_path):
    done = fresh_python("-m", "memsgyro_jax.app.cli", "sweep", *SMALL, JAX_ENABLE_X64="0")
    assert (done.returncode, done.stdout) == (2, "")
    assert "float32" in done.stderr
    assert done.stderr.count("\n") == 1
    assert not (tmp_path / "sweep-out").exists()


@pytest.mark.usefixtures("swept")  # which has compiled the programs
def test_a_disk_that_fills_while_a_store_is_written(memsgyro, folder):
    """No file may exceed 600 bytes: like a full disk, this fails in the middle of writing."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (600, hard))
    try:
        status, _, said = memsgyro("sweep", *SMALL)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert (status, "Traceback" in said) == (2, False), said
    assert "File too large" in said
    assert "make room" in said.splitlines()[-1]
    assert {path.name for path in folder.rglob("*") if "dies.zarr" not in str(path)} <= {"sweep-out"}


@pytest.mark.slow
def test_a_full_disk(folder, root):
    """No file may exceed 600 bytes: like a full disk, this fails in the middle of writing."""
    code = f"""
import resource, sys
resource.setrlimit(resource.RLIMIT_FSIZE, (600, {resource.RLIM_INFINITY}))
from memsgyro_jax import cli
for tokens in ({["sweep", *SMALL]}, {["simulate", *RUN, "--out", "out"]}):
    try:
        cli.main(tokens)
    except SystemExit as end:
        print(end.code)
    print("NEXT", file=sys.stderr, flush=True)
"""
    clean = {name: value for name, value in os.environ.items() if not name.startswith(("XLA_FLAGS", "JAX_"))}
    clean |= {"PYTHONPATH": str(root), "MPLCONFIGDIR": str(folder)}
    clean["JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS"] = "1e9"  # reads what other tests compiled, and writes no half
    command = [sys.executable, "-c", code]
    done = subprocess.run(command, capture_output=True, text=True, check=False, cwd=folder, env=clean)
    assert done.stdout.split()[-2:] == ["2", "2"], done.stderr
    assert "Traceback" not in done.stderr
    for said in done.stderr.split("NEXT\n")[:2]:
        assert "File too large" in said
        assert "make room" in said.splitlines()[-1]
    written = {path.name for path in folder.rglob("*") if ".zarr" not in str(path.relative_to(folder))}
    assert not {name for name in written if name.endswith((".html", "summary.json", ".part"))}


def test_a_page_that_cannot_be_made_leaves_no_half_of_the_results(memsgyro, folder, monkeypatch):
    """The page is made before the command writes its files; the figures lie beside the store since it is whole."""
    monkeypatch.setattr("memsgyro_jax.app.report.sweep_page.sweep_page", _broken)
    with pytest.raises(ZeroDivisionError):
        cli._run(cli.app, ["sweep", *SMALL])
    assert {path.name for path in (folder / "sweep-out").iterdir()} == {"dies.zarr", "summary.json"}
    assert "study" not in json.loads((folder / "sweep-out" / "summary.json").read_text())


def _broken(*_):
    raise ZeroDivisionError
