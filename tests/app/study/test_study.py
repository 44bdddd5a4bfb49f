"""Study files: what they describe, that they survive writing, and that everything wrong with one is said at once."""

import jax
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import memsgyro_jax as mg
from memsgyro_jax.app.study.plan import within
from memsgyro_jax.base.complaints import _lines
from memsgyro_jax.base.provenance import fingerprint


FULL = """
schema = "memsgyro-study/1"

[device]
kind = "dual_mass"
mass_x = { value = 260, unit = "ug" }
mass_y = "160 ug"
kxx = "92.38 uN/um"
kyy = "85.26 N/m"
kxy = "0.92 N/m"
kyx = "0.25 N/m"
dxx = "5.2 mg/s"
dyy = "4.8e-6 N*s/m"
rotating_frame = true

[readout]
kind = "velocity"
scale = ["5 V/(m/s)", "4 V*s/m"]
noise_density = "1 uV/sqrt(Hz)"
adc = { limit = "2 V", bits = 14 }

[observer]
kind = "ekf"
known = ["sigma_x", "sigma_y"]
with_offsets = false
iterations = 2
discretisation = "euler"
fading = { kind = "fixed", forgetting = "1400 1/s" }
annealing = { excess = 500, decay = "1 ms" }
process_noise = { rate = "1e-3 rad^2/s^3", kxx = "1e4 1/s^5", velocity = "1e-9 m^2/s^3" }
prior = { spread = "20 %", rate_std = "100 deg/s" }

[controller]
kind = "reference_model"
frequency = ["3 kHz", "5 kHz"]
tones = [{ frequency = "600 Hz", amplitude = "50 m/s^2", phase = "90 deg", axis = "y" }]

[filter]
kind = "bandpass"
low = "5 Hz"
high = "2 kHz"

[loop]
displacement = "1 um"
discretisation = "euler"

[scenario]
rate = ["100 deg/s", { kind = "sine", amplitude = "10 deg/s", frequency = "20 Hz" }]

[scenario.damping_change]
dxx = { kind = "step", at = "50 ms", after = "10 %" }

[scenario.offset_drift]
y = { kind = "ramp", slope = "1 mV/s" }

[spread]
relative = "10 %"

[spread.parameters]
"device.kxx" = { kind = "normal", std = "2 N/m" }
"start.0" = { kind = "uniform", low = "0.9 um", high = "1.1 um" }

[sweep]
dies = 12
sample_rate = "200 kHz"
duration = "20 ms"
tolerance = "5 deg/s"
seed = 7
"""


LYAPUNOV = """
[observer]
kind = "lyapunov"
gain = 12
known = ["sigma"]
start = 0.8
frequency = "18000 rad/s"
"""


@pytest.fixture
def write(tmp_path):
    def write(text, name="study.toml"):
        path = tmp_path / name
        path.write_text(text, encoding="utf-8")
        return path

    return write


def refusal(path):
    with pytest.raises(mg.InputError) as error:
        mg.load_study(path)
    return str(error.value)


def same(a, b):
    return fingerprint(a.loop, a.scenario, a.spread) == fingerprint(b.loop, b.scenario, b.spread) and a.file == b.file


def test_the_default_study_is_the_main_job():
    gyro, readout = mg.SingleMassGyro.chi2010(), mg.ChargeAmplifier.chi2010()
    observer = mg.ExtendedKalmanFilter.for_device(gyro, readout, annealing=mg.Annealing())
    loop = mg.ClosedLoop(gyro, readout, observer, mg.DampingCompensation(tones=mg.Tone(600.0, 53.95)))
    study = mg.default_study()
    assert fingerprint(study.loop) == fingerprint(loop)
    assert fingerprint(study.spread) == fingerprint(mg.Spread.relative(0.15))
    assert float(study.scenario.at(0.01).inertial.rate) == 1.0
    wanted = {"dies": 256, "sample_rate": 100e3, "duration": 0.1, "settle": None, "seed": 0, "chunk": None}
    assert study.settings.numbers().items() >= wanted.items()


def test_a_full_study_describes_what_it_says(write):
    study = mg.load_study(write(FULL))
    loop = study.loop
    assert isinstance(loop.device, mg.DualMassGyro)
    assert float(loop.device.mass_x) == pytest.approx(2.6e-7, rel=1e-14)
    assert float(loop.device.dxx) == pytest.approx(5.2e-6, rel=1e-14)
    assert loop.device.rotating_frame
    assert [float(s) for s in loop.readout.scale] == [5.0, 4.0]
    assert (float(loop.readout.adc.limit), loop.readout.adc.bits) == (2.0, 14)
    observer, names = loop.observer, loop.device.model.names
    assert {names[i] for i in observer.estimated} == set(names) - {"sigma_x", "sigma_y"}
    assert (observer.iterations, observer.with_offsets) == (2, False)
    assert isinstance(observer.discretisation, mg.ForwardEuler)
    assert isinstance(loop.discretisation, mg.ForwardEuler)
    assert float(observer.fading.forgetting) == 1400.0
    assert float(observer.process_noise.theta[names.index("kxx")]) == 1e4
    assert [float(q) for q in observer.process_noise.motion] == [0.0, 0.0, 1e-9, 1e-9]
    assert float(observer.prior.theta_std[names.index("rate")]) == pytest.approx(np.radians(100.0))
    x, y = loop.controller.tones
    assert x == ()
    assert float(y[0].phase) == pytest.approx(np.pi / 2)
    now = study.scenario.at(0.0625)
    assert float(now.inertial.rate) == pytest.approx(np.radians(110.0))
    assert [float(c) for c in now.inertial.damping_change] == pytest.approx([0.1, 0.0, 0.0])
    assert [float(o) for o in now.offset_drift] == pytest.approx([0.0, 6.25e-5])
    drawn = dict(zip(*(lambda d: (d.parameters, d.table.T))(_draw(study)), strict=True))
    assert set(drawn) == {"device.kxx", "start.0", "device.mass_x", "device.mass_y"} | {
        f"device.{name}" for name in ("kyy", "kxy", "kyx", "dxx", "dyy")
    }
    assert 1.0 < np.std(drawn["device.kxx"]) < 3.0
    assert np.all((drawn["start.0"] > 0.9e-6) & (drawn["start.0"] < 1.1e-6))
    assert study.settings.tolerance == pytest.approx(np.radians(5.0))


def _draw(study):
    return study.spread.draw(study.loop, study.scenario, study.settings.seed, np.arange(64))


@pytest.mark.parametrize("text", ["", FULL], ids=["default", "full"])
def test_writing_and_reading_gives_the_same_study(write, tmp_path, text):
    study = mg.load_study(write(text))
    again = mg.load_study(study.write(tmp_path / "again.toml"))
    assert same(again, study)
    assert again.to_toml() == study.to_toml()


@settings(max_examples=12)
@given(mass=st.floats(1e-9, 1e-3), decay=st.floats(1e-6, 1.0), seed=st.integers(0, 2**31))
def test_numbers_survive_writing_to_the_last_bit(tmp_path_factory, mass, decay, seed):
    changes = {"device.mass": f"{mass!r} kg", "observer.annealing.decay": f"{decay!r} s", "sweep.seed": seed,
               "sweep.sample_rate": "1 GHz"}  # fmt: skip
    study = mg.default_study().changed(changes)
    assert float(study.loop.device.mass) == mass
    again = mg.load_study(study.write(tmp_path_factory.mktemp("study") / "study.toml"))
    assert float(again.loop.device.mass) == mass
    assert float(again.loop.observer.annealing.decay) == decay
    assert again.settings.seed == seed


@pytest.mark.parametrize(
    ("section", "holds"),
    [
        (
            '[readout]\nkind = "displacement"\nscale = "0.1 V/um"\nnoise_density = "0.5 uV/sqrt(Hz)"\n',
            lambda s: float(s.loop.readout.scale[1]) == 1e5,
        ),
        (
            '[readout]\nkind = "velocity"\nscale = "5 V*s/m"\n' + LYAPUNOV,
            lambda s: float(s.loop.observer.gain[0]) == 12.0 and float(s.loop.observer.frequency) == 18000.0,
        ),
        (
            '[observer]\nkind = "ekf"\nfading = { kind = "adaptive", window = "2 ms" }\n',
            lambda s: float(s.loop.observer.fading.window) == 2e-3 and s.loop.observer.annealing is None,
        ),
        (
            '[observer]\nkind = "ekf"\nnoise_density = "2 uV/sqrt(Hz)"\n',
            lambda s: [float(d) for d in s.loop.observer.noise_density] == [2e-6, 2e-6],
        ),
        (
            '[controller]\nkind = "open_loop"\ntones = [{ frequency = "3 kHz", amplitude = "1 uN", axis = "x" }]\n',
            lambda s: float(s.loop.controller.tones[0][0].amplitude) == 1e-6 and s.loop.controller.tones[1] == (),
        ),
        (
            '[controller]\nkind = "classic"\namplitude = "2 um"\nphase_gain = "30 1/s"\ndemodulator = "product"\n',
            lambda s: isinstance(s.loop.observer, mg.NoObserver) and float(s.loop.controller.drive.amplitude) == 2e-6
            and float(s.loop.controller.drive.phase_gain) == 30.0 and float(s.loop.start[0]) == 0.0
            and isinstance(s.loop.controller.sense.demodulator, mg.ProductDemodulator),
        ),
        (
            '[scenario.rate]\nkind = "chirp"\namplitude = "1 rad/s"\nlow = "0 Hz"\nhigh = "5 Hz"\nduration = "1 s"\n',
            lambda s: isinstance(s.scenario.rate, mg.Chirp),
        ),
        (
            '[scenario]\nrate = { kind = "random_walk", intensity = "1 rad^2/s^3", duration = "1 s", rows = 500 }\n',
            lambda s: s.scenario.rate == mg.RandomWalk(1.0, 1.0, rows=500),
        ),
        (
            """[filter]
kind = "lowpass"
bandwidth = "20 Hz"
[spread.parameters]
"filter.bandwidth" = { kind = "normal", std = "2 Hz" }
""",
            lambda s: float(s.loop.filter.bandwidth) == 20.0 and s.loop.filter.order == 3
            and s.spread.items[0].distribution.std == 2.0,
        ),
        (
            '[filter]\nkind = "bandpass"\nlow = "10 Hz"\nhigh = "1 kHz"\norder = 2\n',
            lambda s: float(s.loop.filter.high) == 1000.0 and s.loop.filter.order == 2,
        ),
        ("[spread]\nrelative = 0\n", lambda s: s.spread.resolved(s.loop) == ()),
    ],
)  # fmt: skip
def test_other_members(write, tmp_path, section, holds):
    study = mg.load_study(write(section))
    assert holds(study)
    assert same(mg.load_study(study.write(tmp_path / "again.toml")), study)


def test_noise_as_the_thesis_states_it(write):
    """SNR 100 on 1 µm at 10 MHz is the noise of Table 5.3, up to the 0.05 % by which its scale exceeds 100 mV/µm."""
    text = mg.default_study().to_toml()
    density = next(line for line in text.splitlines() if line.startswith("noise_density"))
    study = mg.load_study(
        write(text.replace(density, 'snr = { ratio = 100, amplitude = "1 um", sample_rate = "10 MHz" }'))
    )
    wanted = mg.ChargeAmplifier.chi2010().noise_density[0]
    assert float(study.loop.readout.noise_density[0]) == pytest.approx(float(wanted), rel=1e-3)


@pytest.mark.parametrize(
    "kind",
    [
        'kind = "displacement"\nscale = "1 V/um"',
        'kind = "capacitive"\ngradient = "5 nF/m"\ncapacitance = "0.5 pF"\nbias = "10 V"\nfeedback = "1 pF"',
    ],
)
def test_a_readout_may_flicker(write, tmp_path, kind):
    density = 'noise_density = "1 uV/sqrt(Hz)"'
    study = mg.load_study(
        write(f'[readout]\n{kind}\n{density}\nflicker = {{ delay = ["0 s", "2 ns"], lowest = "10 mHz" }}\n')
    )
    flicker = study.loop.readout.flicker
    assert [float(delay) for delay in flicker.delay] == pytest.approx([0.0, 2e-9])
    assert (float(flicker.lowest), flicker.decades) == (0.01, 5)
    assert same(mg.load_study(study.write(tmp_path / "again.toml")), study)


def test_a_recorded_rate_lies_beside_its_study(write, tmp_path):
    (tmp_path / "records").mkdir()
    (tmp_path / "records" / "turn.csv").write_text("t [ms],rate [deg/s]\n5,0\n15,90\n25,90\n")
    study = mg.load_study(write('[scenario]\nrate = { kind = "record", file = "records/turn.csv" }\n'))
    assert float(study.scenario.at(5e-3).inertial.rate) == pytest.approx(np.radians(45.0))
    again = study.write(tmp_path / "again.toml")
    assert 'file = "records/turn.csv"' in again.read_text()
    assert same(mg.load_study(again), study)


def test_a_loop_may_be_taken_in_blocks(tmp_path):
    study = mg.default_study().changed({"loop.block": 256})
    assert study.loop.blocks.length == 256
    assert mg.load_study(study.write(tmp_path / "s.toml")).loop.blocks == study.loop.blocks
    assert mg.default_study().loop.blocks is None


def test_changes_are_checked_like_a_file():
    study = mg.default_study()
    assert study.changed({"sweep.dies": 3, "device.mass": "2e-7 kg"}).settings.dies == 3
    with pytest.raises(
        mg.InputError, match=r"^the default study, changed: `sweep.dies`: must be greater than or equal to 1"
    ):
        study.changed({"sweep.dies": 0})


def test_a_study_is_frozen_and_prints_itself():
    study = mg.default_study()
    assert "[device]" in repr(study)
    with pytest.raises(AttributeError):
        study.loop = None
    with pytest.raises(ValueError, match="frozen"):
        study.settings.dies = 4
    assert len(jax.tree.leaves(study.loop)) > 20


BAD = [
    # (replace, by, what the sentence must say, all of it)
    ('mass_x = { value = 260, unit = "ug" }', "mass_x = 2.6e-7", ["line 6, `device.mass_x`", "must carry a unit"]),
    ('mass_y = "160 ug"', 'mass_y = "160 um"', ["line 7, `device.mass_y`", '"kg"', '"um"']),
    ('mass_y = "160 ug"', 'mass_y = "160 furlongish"', ["line 7, `device.mass_y`", '"furlongish"']),
    ('mass_y = "160 ug"', 'mass_y = "-160 ug"', ["line 7, `device.mass_y`", "greater than 0"]),
    ('mass_y = "160 ug"', 'mass_y = "270 ug"', ["`device`", "mass_x - mass_y", "positive"]),
    ('mass_y = "160 ug"', 'mass_y = { value = 160, units = "ug" }', ["line 7", '"unit"']),
    ('mass_y = "160 ug"', "mass_y = true", ["line 7", "number with a unit"]),
    ('mass_y = "160 ug"', 'mass_y = { value = inf, unit = "ug" }', ["line 7", "finite"]),
    ('mass_y = "160 ug"', 'mass_y = "1,6e2 ug"', ["line 7", "1,6e2 ug"]),
    ('kxy = "0.92 N/m"', 'kxy = "92 N/m"\nkyxx = "1 N/m"', ["`device.kyxx`", "line 11", "did you mean `kyx`"]),
    ('kxy = "0.92 N/m"', 'kxy = "92000 N/m"', ["`device`", "kxx*kyy - kxy*kyx", "positive"]),
    ('dyy = "4.8e-6 N*s/m"', "", ["line 4, `device.dyy`", "is missing"]),
    ('kind = "dual_mass"', 'kind = "triple_mass"', ["line 4", '"single_mass" or "dual_mass"', '"triple_mass"']),
    ('kind = "dual_mass"', "", ["line 4, `device`", "must have a kind", "has none"]),
    ("bits = 14", "bits = 64", ["line 20", "bits", "less than or equal to 48"]),
    ("bits = 14", "bits = 14.5", ["bits", "whole number"]),
    ('noise_density = "1 uV/sqrt(Hz)"', 'noise_density = "-1 uV/sqrt(Hz)"', ["line 19", "greater than or equal to 0"]),
    ('scale = ["5 V/(m/s)", "4 V*s/m"]', 'scale = ["5 V/(m/s)"]', ["line 18", "list of two (x, y)"]),
    ('known = ["sigma_x", "sigma_y"]', 'known = ["sigma"]', ["`observer`", "sigma_x", "`sigma`"]),
    ("iterations = 2", "iterations = 0", ["line 26", "greater than or equal to 1"]),
    ('discretisation = "euler"\nfading', 'discretisation = "rk4"\nfading', ["line 27", "'exact' or 'euler'"]),
    ('kxx = "1e4 1/s^5"', 'kzz = "1e4 1/s^5"', ["line 30", "`observer.process_noise.kzz`", "not known"]),
    ('kxx = "1e4 1/s^5"', 'dxy = "1e4 1/s^3"', ["`observer`", "`dxy`"]),
    ('frequency = ["3 kHz", "5 kHz"]', 'frequency = ["3 kHz"]', ["line 35, `controller.frequency"]),
    ('slope = "1 mV/s"', 'slope = "1 mV"', ["`scenario.offset_drift.y.slope`", '"V/s"', '"mV"']),
    ('rate = ["100 deg/s", {', 'rate = ["100 deg", {', ["line 48", '"rad/s"', '"deg"']),
    ('"device.kxx" = {', '"device.kzz" = {', ["`spread`", "device.kzz"]),
    ('std = "2 N/m"', 'std = "2 kg"', ["line 60, `spread.parameters.device.kxx`", '"N/m"', '"kg"']),
    ('low = "0.9 um", high = "1.1 um"', 'low = "1.9 um", high = "1.1 um"',
     ["line 61, `spread.parameters.start.0`", "low <= high"]),
    ('low = "5 Hz"', 'low = "5 kHz"', ["line 38, `filter`", "must have low below high, but has 5000 Hz and 2000 Hz"]),
    ('high = "2 kHz"', 'high = "2 kHz"\norder = 5', ["line 42, `filter.order`", "less than or equal to 4"]),
    ('high = "2 kHz"', 'high = "200 kHz"', ["line 38, `filter`", "more than twice the filter's 200000 Hz"]),
    ('high = "2 kHz"', "high = 2000", ["line 41, `filter.high`", "must carry a unit"]),
    ('kind = "bandpass"', 'kind = "notch"', ["line 38", '"lowpass" or "bandpass"', '"notch"']),
    ("dies = 12", "dies = 12.5", ["`sweep.dies`", "whole number"]),
    ("dies = 12", 'dies = "12"', ["`sweep.dies`", "whole number"]),
    ('sample_rate = "200 kHz"', 'sample_rate = "5 kHz"', ["`sweep.sample_rate`", "twice the highest", "at least"]),
    ('sample_rate = "200 kHz"', "sample_rate = nan", ["`sweep.sample_rate`"]),
    ('duration = "20 ms"', 'duration = "20 ms"\nsettle = "30 ms"', ["`sweep.settle`", "shorter than the duration"]),
    ("seed = 7", "seed = -7", ["`sweep.seed`", "greater than or equal to 0"]),
    ("seed = 7", "seed = 7\nsead = 7", ["`sweep.sead`", "did you mean `seed`"]),
    ("[sweep]", "[sweeep]", ["`sweeep`", "did you mean `sweep`"]),
    ('schema = "memsgyro-study/1"', 'schema = "memsgyro-study/9"', ["line 2, `schema`", "memsgyro-study/1"]),
    ("seed = 7", "seed = = 7", ["must be TOML", "line 68"]),
]  # fmt: skip


@pytest.mark.parametrize(
    ("old", "new", "words"), BAD, ids=[f"{i}-{new or old}"[:40] for i, (old, new, _) in enumerate(BAD)]
)
def test_what_is_wrong_is_one_sentence_with_its_place(write, old, new, words):
    assert FULL.count(old) == 1, "the case no longer fits the study above"
    path = write(FULL.replace(old, new))
    said = refusal(path)
    assert said.startswith(f"{path}: ")
    assert "\n" not in said
    assert said.endswith(".")
    for word in words:
        assert word in said, said


def test_shared_causes_need_what_they_spread(write):
    """Beside single parameters they were read and did nothing."""
    text = FULL.replace("[spread]\n", "[spread]\nshared = 0.9\n").replace("relative = ", "# ")
    assert "`spread`: shared is the correlation of what relative spreads" in refusal(write(text))


def test_a_stiffness_matrix_that_cannot_stand(write):
    text = mg.default_study().to_toml().replace("12.78 N/m", "80 N/m")
    assert "`device`: The stiffness matrix must be positive definite" in refusal(write(text))


def test_every_error_is_said_at_once(write):
    text = FULL
    for old, new in (("mass_x = {", "massx = {"), ("iterations = 2", "iterations = 0"), ("dies = 12", "dies = 0")):
        text = text.replace(old, new)
    said = refusal(write(text))
    assert said.count("line ") == 4
    places = [
        said.index(name) for name in ("`device.mass_x`", "`device.massx`", "`observer.iterations`", "`sweep.dies`")
    ]
    assert places == sorted(places)
    assert "4 entries must be mended" in said


@pytest.mark.parametrize(
    ("name", "content"), [("missing.toml", None), ("folder.toml", "folder"), ("latin.toml", b"x = '\xb5'")]
)
def test_a_file_that_cannot_be_read(tmp_path, name, content):
    path = tmp_path / name
    if content == "folder":
        path.mkdir()
    elif content is not None:
        path.write_bytes(content)
    assert refusal(path).startswith(f"{path}: ")


def test_lines_of_keys():
    text = 'a = 1\n[b]\nc.d = 2\n"e f" = 3\n[[g.h]]\ni = 1\n[[g.h]]\ni = 2\n'
    assert _lines(text) == {
        ("a",): 1, ("b",): 2, ("b", "c", "d"): 3, ("b", "e f"): 4,
        ("g", "h"): 5, ("g", "h", 0): 5, ("g", "h", 0, "i"): 6, ("g", "h", 1): 7, ("g", "h", 1, "i"): 8,
    }  # fmt: skip


def test_a_uniform_spread_may_be_relative(tmp_path):
    path = tmp_path / "study.toml"
    path.write_text('[spread.parameters]\n"device.mass" = { kind = "uniform", relative = "5 %" }\n')
    (item,) = mg.load_study(path).spread.items
    assert (item.path, item.distribution.relative) == ("device.mass", 0.05)


@pytest.mark.parametrize(
    ("section", "words"),
    [
        ('[controller]\nkind = "classic"\ngain = 2\n', "gain is a gain of a rebalanced sense axis"),
        (
            '[controller]\nkind = "classic"\nbandwidth = "2 Hz"\n',
            "rebalanced sense axis; give `sense_bandwidth`",
        ),
        ('[observer]\nkind = "none"\n', 'line 2, `observer.kind`: must not be "none" with a controller'),
    ],
)
def test_classic_control_needs_its_loops(write, section, words):
    assert words in refusal(write(section))


LAYOUT = """
[device]
kind = "layout"
side = "1.2 mm"
thickness = "50 um"
length_x = "300 um"
length_y = "290 um"
width = "6 um"
gap = "3 um"
pressure = "10 Pa"
loss = 1e-4
temperature = "300 K"
[process]
over_etch = "0.1 um"
[readout]
kind = "layout"
fingers = 113
width = "50 um"
gap = "2 um"
overlap = "50 um"
bias = "10 V"
feedback = "1 pF"
[controller]
kind = "classic"
[spread.parameters]
"process.over_etch" = { kind = "normal", std = "50 nm" }
"device.layout.width" = { kind = "normal", std = "0.02 um" }
"readout.drawn.gap.0" = { kind = "uniform", low = "1.9 um", high = "2.1 um" }
"""


def test_a_layout_and_its_process(write, tmp_path):
    """Device and read-out are what the process makes of both drawings, and vary with it together."""
    study = mg.load_study(write(LAYOUT))
    process, etched = study.loop.device.process, mg.geometry.Process(over_etch=1e-7)
    drawn = mg.geometry.PlateLayout(
        side=1.2e-3, thickness=50e-6, length_x=300e-6, length_y=290e-6, width=6e-6, gap=3e-6, pressure=10.0,
        loss=1e-4,
    )  # fmt: skip
    assert process == study.loop.readout.process == etched
    for name in ("kxx", "dxx"):
        np.testing.assert_allclose(getattr(study.loop.device.made, name), getattr(drawn.made(etched), name), rtol=1e-12)
    assert float(study.loop.device.temperature) == 300.0
    assert abs(float(study.loop.readout.scale[0])) < abs(float(study.loop.readout.drawn.scale[0]))
    assert mg.load_study(study.write(tmp_path / "again.toml")).to_toml() == study.to_toml()
    dies = study.spread.draw(study.loop, study.scenario, 0, np.arange(16))
    np.testing.assert_array_equal(dies.loop.device.process.over_etch, dies.loop.readout.process.over_etch)
    assert np.std(dies.table[:, 0]) == pytest.approx(50e-9, rel=0.3)


def test_a_spread_by_the_names_of_a_designer(write):
    """With the unit of each, beside the coefficients."""
    text = '[spread.parameters]\n"device.quadrature" = { kind = "normal", std = "20 deg/s" }\n'
    items = mg.load_study(write(f'{text}"device.frequency.1" = {{ kind = "normal", std = "1 kHz" }}\n')).spread.items
    found = {item.path: item.distribution.std for item in items}
    assert found == {"device.quadrature": pytest.approx(np.radians(20.0)), "device.frequency.1": 1e3}
    with pytest.raises(mg.InputError, match=r"has no `quadratur` \(did you mean `quadrature`\? known are mass, kxx"):
        mg.load_study(write(text.replace('quadrature"', 'quadratur"')))


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("[spread.parameters]", "[spread]\nrelative = 0.1\n[spread.parameters]", "a LayoutGyro has none of its own"),
        ('side = "1.2 mm"', 'side = "0.15 um"', "`layout.side`"),
        (LAYOUT[LAYOUT.index("[device]") : LAYOUT.index("[process]")], "", "has no `layout`|has no `device`"),
        (LAYOUT[: LAYOUT.index("[controller]")], "[process]\n", "`process`: must make a device or a readout"),
        ('std = "50 nm"', 'std = "50 nF"', "F"),
    ],
)
def test_what_a_layout_refuses(write, old, new, words):
    with pytest.raises(mg.InputError, match=words):
        mg.load_study(write(LAYOUT.replace(old, new)))


def test_a_share_in_place_of_a_unit_is_told_where_it_goes():
    with pytest.raises(ValueError, match=r'as "Hz", but is "%"; a share of the design value is given as `relative`'):
        within("1.0 %", "Hz", "std")
    assert within("1.0 %", "1", "std") == pytest.approx(0.01)
    with pytest.raises(ValueError, match=r'as "Hz", but is "kg"\.?$'):
        within("1.0 kg", "Hz", "std")
