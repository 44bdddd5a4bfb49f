"""`memsgyro tornado` and `memsgyro loop` as a user runs them, against the functions that they are made of."""

import json
from typing import get_args

import numpy as np
import pytest

import memsgyro_jax as mg
from memsgyro_jax.app.commands.loop import Disturbance
from memsgyro_jax.loop.linearised import INPUTS


STUDY = """
schema = "memsgyro-study/1"
[device]
kind = "single_mass"
mass = "180 ug"
frequency = ["3 kHz", "3.6 kHz"]
quality_factor = [900, 900]
cross_damping = 0.1
[readout]
kind = "displacement"
scale = "0.1 V/um"
noise_density = "0.1 uV/sqrt(Hz)"
[observer]
kind = "ekf"
known = ["kxx", "kyy", "kxy", "dxx", "dyy", "dxy", "sigma"]
with_offsets = false
[controller]
kind = "open_loop"
[spread.parameters]
"device.dxy" = { kind = "normal", relative = 0.1 }
"device.kxx" = { kind = "normal", relative = 0.001 }
[sweep]
sample_rate = "40 kHz"
duration = "5 ms"
"""


@pytest.fixture
def study(folder):
    """Lies where the command line is run."""
    path = folder / "study.toml"
    path.write_text(STUDY)
    return path


@pytest.mark.slow
def test_a_tornado_of_the_zero_rate_output(memsgyro, folder, study):
    """A filter that knows all but the rate takes what cross damping changes for a rate of it over 2 m."""
    given = ("--zero-rate", "--repeats", 2, "--report", "bars.html", "--json", "bars.json")
    status, out, _ = memsgyro("tornado", study, *given)
    assert (status, "zero-rate output" in out, "device.dxy" in out) == (0, True, True)
    (told,) = json.loads((folder / "bars.json").read_text())["outputs"]
    largest = told["inputs"][0]
    assert (largest["name"], told["name"]) == ("device.dxy", "zero-rate output")
    sigma = 0.1 * float(mg.load_study(study).loop.device.dxy)
    assert abs(largest["high"]) == pytest.approx(np.degrees(sigma / (2.0 * 180e-9)), rel=0.1)
    assert largest["gradient"] == pytest.approx(largest["high"], rel=0.01)
    assert largest["standard_error"] == 0.0  # the read-out is silent
    assert (folder / "bars.html").read_text().count("<svg") == 1


@pytest.mark.slow
def test_a_loop_over_frequency(memsgyro, folder, study):
    status, out, _ = memsgyro("loop", study, "--frequencies", 500, 900, "--report", "l.html", "--json", "l.json")
    assert (status, "half the power" in out, "°/√h" in out) == (0, True, True)
    told = json.loads((folder / "l.json").read_text())
    answer = mg.frequency_response(
        mg.load_study(study).loop, [500.0, 900.0], sample_rate=40e3, duration=5e-3, settle=2.5e-3
    )
    assert told["responses"]["rate"]["gain"] == pytest.approx(np.abs(answer.response).tolist())
    assert told["margins"] is None
    assert told["noise"]["walk_deg_per_root_hour"]["electronics"] > 0.0
    assert (folder / "l.html").read_text().count("<svg") == 2


def test_what_they_refuse(memsgyro):
    assert memsgyro("loop", study, "--disturbance", "heat")[0] == 2
    assert memsgyro("tornado", study, "--sigmas", 0)[0] == 2
    assert memsgyro("tornado", "nowhere.toml")[0] == 2


CLASSIC = """
schema = "memsgyro-study/1"
[device]
kind = "single_mass"
mass = "15 ug"
frequency = ["17.2 kHz", "17.65 kHz"]
quality_factor = [300, 150]
[readout]
kind = "displacement"
scale = "0.1 V/um"
noise_density = "0.1 uV/sqrt(Hz)"
[controller]
kind = "classic"
sense = "open"
[sweep]
sample_rate = "172 kHz"
duration = "2 ms"
"""


@pytest.mark.slow
def test_a_classic_loop_is_looked_at_once_it_rests(memsgyro, folder, study):
    """The study's own runs would show the start, from a frequency on that is none of slow rates."""
    (folder / "classic.toml").write_text(CLASSIC)
    status, out, _ = memsgyro("loop", "classic.toml", "--json", "rested.json")
    assert status == 0
    assert "in which the loop comes to rest: the 0.002 s of the study would show its start" in out
    told = json.loads((folder / "rested.json").read_text())["responses"]["rate"]
    at, rest = np.array(told["frequency_hz"]), np.array(told["rest"])
    assert at[0] < 150.0
    assert 0.45 * 17.2e3 < at[-1] <= 0.5 * 17.3e3  # the split and the fall-off lie below
    assert 450.0 < told["bandwidth_hz"] < 1500.0
    assert told["peak"]["frequency_hz"] == pytest.approx(450.0, rel=0.1)
    assert "a peak of" in next(line for line in out.splitlines() if line.startswith("Response"))
    assert np.max(rest[at < 450.0]) < 0.02
    assert "comes to rest" not in memsgyro("loop", "classic.toml", "--duration", "3 ms", "--frequencies", 1000, 2000)[1]


def test_an_unknown_disturbance_is_refused_before_anything_is_imported(fresh_python, folder):
    """It took 8 s of margins and noise until then."""
    code = (
        "import sys\nfrom memsgyro_jax.app import cli\ntry:\n    cli.main(['loop', '--disturbance', 'torque'])\n"
        "except SystemExit as end:\n    print(end.code, 'jax' in sys.modules)"
    )
    done = fresh_python("-c", code)
    assert done.stdout.split() == ["2", "False"]
    assert all(name in done.stderr for name in ("torque", *INPUTS))
    assert get_args(Disturbance) == tuple(INPUTS)
