"""The laboratory against exact solutions, energy, and the bench's own records where they are at hand."""

import json
from dataclasses import replace

import numpy as np
import pytest
from lab.die import Die, Hidden, Outside
from lab.experiments import Bench, perform
from lab.flow import integrate
from lab.instrument import cycle_phasors
from lab.laboratory import make_case
from lab.orbit import march, steady
from lab.plant import Plant
from lab.protocol import Laboratory, Multisine, Profile, RateTable, Raw, RingDown, Sweep
from lab.rows import rows
from lab.strengths import OUTSIDE, VISIBLE, visible
from scipy.integrate import solve_ivp
from scipy.linalg import expm


DIE = Die.drawn(np.random.default_rng(3))
SWEEP = Sweep("sweep", 0, (2e-8, 1.5e-7), points=5, span=6.0, dense=np.inf)


def done(experiment, hidden=None, die=DIE, **lab):
    """Record of one experiment on a die."""
    laboratory = Laboratory((experiment,), **lab)
    return perform(experiment, Bench(Plant(die, hidden or Hidden()), laboratory, np.random.default_rng(0)))


def matrices(die):
    k = np.array([[die.kxx, die.kxy], [die.kxy, die.kyy]])
    return k, np.array([[die.dxx, die.dxy], [die.dxy, die.dyy]])


def response(die, w, rate=0.0):
    """Displacement phasors (n, 2) per newton on x."""
    k, d = matrices(die)
    d = d + 2 * die.mass * rate * np.array([[0, -1], [1, 0]])
    w = np.asarray(w)[:, None, None]
    return np.linalg.solve(k - w**2 * die.mass * np.eye(2) + 1j * w * d, np.array([[1.0], [0.0]]))[:, :, 0]


def first_order(die, rate=0.0):
    """State matrix of a die with nothing hidden."""
    k, d = matrices(die)
    d = d + 2 * die.mass * rate * np.array([[0, -1], [1, 0]])
    return np.block([[np.zeros((2, 2)), np.eye(2)], [-k / die.mass, -d / die.mass]])


def test_a_settled_sweep_is_linear_algebra():
    record = done(SWEEP)
    force, f = record.columns["F_x [nN]"] * 1e-9, record.columns["f [Hz]"]
    expected = DIE.scale * force[:, None] * response(DIE, 2 * np.pi * f)
    np.testing.assert_allclose(record.clean, expected, rtol=1e-10)


def test_a_delay_turns_phasors():
    plain, late = done(SWEEP), done(SWEEP, Hidden(readout_delay=4e-7))
    turn = np.exp(-2j * np.pi * plain.columns["f [Hz]"] * 4e-7)
    np.testing.assert_allclose(late.clean, plain.clean * turn[:, None], rtol=1e-10)


def test_a_clipped_sine_has_the_known_fundamental():
    die = replace(DIE, kxy=0.0, dxy=0.0, offset_x=0.0)
    free, clipped = done(SWEEP, die=die).clean[:, 0], done(SWEEP, Hidden(adc_saturation=1 / 0.2), die=die).clean[:, 0]
    part = np.minimum(0.2 / np.abs(free), 1.0)
    gain = 2 / np.pi * (np.arcsin(part) + part * np.sqrt(1 - part**2))
    assert np.sum(part < 1) > 3
    np.testing.assert_allclose(clipped, gain * free, rtol=1e-9)


def test_a_moving_frequency_follows_the_second_derivative():
    # Z = H - i s H''/2 + O(s²) for a drive cos(w t + s t²/2): half the speed, a quarter of what is left.
    w = 2 * np.pi * done(SWEEP).columns["f [Hz]"]
    step = 0.5
    h = [response(DIE, w + i * step) for i in (-2, -1, 0, 1, 2)]
    bend = (-h[0] + 16 * h[1] - 30 * h[2] + 16 * h[3] - h[4]) / (12 * step**2)
    force = done(SWEEP).columns["F_x [nN]"][:, None] * 1e-9 * DIE.scale
    left = []
    for speed in (0.2, 0.1):
        moved = done(SWEEP, Hidden(finite_sweep_rate=speed)).clean
        left.append(np.max(np.abs(moved / force - h[2] + 0.5j * speed * bend)))
    assert np.max(np.abs(0.05 * bend)) > 20 * left[1]
    assert left[0] / left[1] == pytest.approx(4.0, rel=0.1)


def test_held_forces_are_matrix_exponentials():
    record = done(Raw("raw", samples=400))
    a, u = first_order(DIE), np.stack([record.columns["u_x [nN]"], record.columns["u_y [nN]"]]) * 1e-9
    b = np.vstack([np.zeros((2, 2)), np.eye(2) / DIE.mass])
    both = expm(5e-6 * np.block([[a, b], [np.zeros((2, 6))]]))
    state, seen = np.zeros(4), []
    for k in range(400):
        seen.append(DIE.scale * state[:2] + DIE.offset)
        state = both[:4, :4] @ state + both[:4, 4:] @ u[:, k]
    np.testing.assert_allclose(record.clean, seen, rtol=1e-9, atol=1e-12)


def test_a_ring_down_starts_from_rest_and_decays_freely():
    record = done(RingDown("ringdown", 0, duration=0.02, samples=50))
    w = 2 * np.pi * round(float(DIE.resonances()[0]), 1)
    cycles = int(0.02 * w / 2 / np.pi)
    z = 1.5e-7 * response(DIE, [w])[0]
    settled = np.concatenate([z.real, (1j * w * z).real])
    a = first_order(DIE)
    start = settled - expm(a * cycles * 2 * np.pi / w) @ settled
    expected = [DIE.scale * (expm(a * t) @ start)[:2] + DIE.offset for t in record.columns["t [s]"]]
    np.testing.assert_allclose(record.clean, expected, rtol=1e-9, atol=1e-12)


def test_a_rate_step_settles_on_the_new_response():
    profile = Profile((0.0, 90.0), 0.5, (0.0, 1.0, 1.0, 0.0), (0.0, 0.0, 0.0))
    record = done(RateTable("rate", cycles=15, blocks=190, profile=profile))
    w = 2 * np.pi * round(float(DIE.resonances()[0]), 1)
    for block, rate in ((0, 0.0), (-1, np.pi / 2)):
        expected = DIE.scale * 6e-8 * response(DIE, [w], rate)[0]
        assert record.columns["rate [deg/s]"][block] == pytest.approx(np.degrees(rate))
        np.testing.assert_allclose(record.clean[block], expected, rtol=1e-9 if block == 0 else 2e-2)


def test_blocks_side_by_side_are_one_long_integration():
    hidden = visible("cubic_stiffness_x", "cross_stiffness", "squeeze_film_damping_y", "parasitic_mode_x", "maxwell_y")
    plant, n = Plant(DIE, hidden), 40
    rate = np.linspace(0, 3, n)
    w = np.full(n, 2 * np.pi * 3000.0)
    own = rows(DIE, hidden, n, rate=rate, frequency=w, swing=np.array([[1e-6], [2e-7]]) * np.ones(n))
    times = np.arange(n + 1) / 3000.0
    states = march(plant, own, times, np.zeros(plant.size))
    scale, one = np.array(plant.weights), np.zeros(plant.size)

    def slope(t, s, row):
        return plant.slope(np.array([t]), (s * scale)[:, None], row, np.empty((0, 1)))[:, 0] / scale

    for k in range(n):
        row = (own.take(slice(k, k + 1)),)
        one = solve_ivp(slope, times[k : k + 2], one, args=row, method="DOP853", rtol=1e-11, atol=1e-14).y[:, -1]
    np.testing.assert_allclose(states[:, -1] / scale, one, atol=1e-9 * np.max(np.abs(one)))


def free(plant, state, seconds):
    """State after a free motion of one row."""
    own = rows(plant.die, plant.hidden, 1, rate=2.0)
    return integrate(plant, state[:, None], np.zeros(1), np.full(1, seconds), own, plant.die.period)[:, 0]


@pytest.mark.parametrize("stop", [0.0, pytest.param(5.0, marks=pytest.mark.slow)])
def test_springs_and_rotation_keep_the_energy(stop):
    die = replace(DIE, dxx=0.0, dyy=0.0, dxy=0.0)
    outside = Outside(stop_x=stop, stop_gap=5e-7, stop_two_sided=True)
    hidden = Hidden(
        cubic_stiffness_x=2e12, quadratic_stiffness_y=2e6, cross_stiffness=1e12, centrifugal=1e3, outside=outside
    )

    def energy(s):
        x, y, vx, vy = s
        springs = 0.5 * (die.kxx * x**2 + die.kyy * y**2) + die.kxy * x * y + 5e11 * x**4 + 2e6 / 3 * y**3
        springs += 5e11 * x**2 * y**2 - 0.5 * die.mass * 1e3 * 4.0 * (x**2 + y**2)
        return 0.5 * die.mass * (vx**2 + vy**2) + springs + 0.5 * stop * np.maximum(np.abs(x) - 5e-7, 0) ** 2

    start = np.array([1e-6, 5e-7, 0.01, 0.0])
    end = free(Plant(die, hidden), start, 0.02)
    assert not np.allclose(end, start, rtol=0.01)
    assert energy(end) == pytest.approx(energy(start), rel=1e-9)


def test_dry_friction_takes_a_fixed_bite_per_half_cycle_and_then_holds():
    die = replace(DIE, dxx=0.0, dyy=0.0, dxy=0.0, kxy=0.0)
    plant, bite = Plant(die, Hidden(dry_friction_x=0.05 * die.kxx * 1e-6)), 0.1e-6
    half = np.pi * np.sqrt(die.mass / die.kxx)
    own = rows(die, plant.hidden, 1)
    start = np.array([1e-6, 0.0, 0.0, 0.0])[:, None]
    for halves in (1, 4, 9):
        end = integrate(plant, start, np.zeros(1), np.full(1, halves * half), own, die.period)
        expected = [(-1) ** halves * (1e-6 - halves * bite), 0, 0, 0]
        np.testing.assert_allclose(end[:, 0] / plant.weights, np.array(expected) / plant.weights, atol=1e-11)
    held = integrate(plant, start, np.zeros(1), np.full(1, 40 * half), own, die.period)[:, 0]
    assert abs(held[0]) <= 0.5 * bite * (1 + 1e-9)
    assert held[2] == 0.0


def test_an_inner_mode_that_follows_is_a_softening_spring():
    """Far above, z = −(s/m)·x²/(w² − (0 or 2ω)²), which pulls like k3 x³; the dip it leaves is second order in that."""
    die, ratio = replace(DIE, kxy=0.0, dxy=0.0), 6.0
    w = np.sqrt(die.kxx / die.mass)
    s = 1e-2 * die.kxx / 1e-6
    k3 = -4 / 3 * s**2 / die.mass / w**2 * (1 / ratio**2 + 0.5 / (ratio**2 - 4))
    outside = Outside(internal_x=s, internal_ratio=ratio, internal_quality=1e6)
    free, inner, spring = (
        done(SWEEP, hidden, die).clean for hidden in (Hidden(), Hidden(outside=outside), Hidden(cubic_stiffness_x=k3))
    )
    assert np.max(np.abs(inner - spring)) < 0.02 * np.max(np.abs(spring - free))


def test_hysteresis_loses_energy_in_every_loop():
    die = replace(DIE, dxx=0.0, dyy=0.0, dxy=0.0, kxy=0.0)
    plant = Plant(die, Hidden(outside=Outside(bouc_wen_x=0.5)))
    amplitude = [1e-6]
    state = np.array([1e-6, 0, 0, 0, 0.0])
    for _ in range(3):
        state = free(plant, state, 10 * die.period)
        amplitude.append(np.hypot(state[0], state[2] * np.sqrt(die.mass / die.kxx)))
    assert np.all(np.diff(amplitude) < -1e-9)
    assert abs(state[4]) <= plant.outside.bouc_wen_yield


TINY = Laboratory(
    (
        replace(SWEEP, name="sweep_x", points=3),
        replace(SWEEP, name="sweep_y", axis=1, points=3),
        Sweep("bias", 0, (5.0, 15.0), "bias", points=3, span=3.0, dense=np.inf),
        Sweep("soak", 0, (-40.0, 85.0), "temperature", points=3, span=3.0, dense=np.inf),
        RateTable("rate", cycles=2, blocks=12, profile=Profile((0.0, 90.0), 3e-3)),
        RateTable("static", cycles=2, blocks=12),
        RingDown("ringdown", 0, duration=5e-3, samples=5, force=3e-7),
        Raw("raw", interval=1e-5, samples=200),
    )
)
SHORT = {"damping_step_time": 1.5e-3}


@pytest.fixture(scope="module")
def untouched():
    return {e.name: done(e) for e in TINY.experiments}


@pytest.mark.slow
@pytest.mark.parametrize("name", [*VISIBLE, "rate_bias_drift", *OUTSIDE])
def test_every_effect_shows_somewhere(name, untouched):
    hidden = replace(visible(name), **SHORT)
    plant, seen = Plant(DIE, hidden), 0.0
    for e in TINY.experiments:
        clean = perform(e, Bench(plant, TINY, np.random.default_rng(0))).clean
        assert np.all(np.isfinite(clean))
        seen = max(seen, np.max(np.abs(clean - untouched[e.name].clean)) / np.max(np.abs(untouched[e.name].clean)))
    assert seen > 1e-5


@pytest.mark.slow
def test_many_effects_live_together():
    names = [
        "cubic_stiffness_x",
        "quadratic_damping_y",
        "dry_friction_x",
        "adc_saturation",
        "readout_delay",
        "maxwell_x",
    ]
    record = done(SWEEP, visible(*names, "bouc_wen_y", "parasitic_mode_y", "drive_heating_x"))
    assert np.all(np.isfinite(record.clean))


def test_a_motion_without_limit_is_refused():
    unstable = replace(DIE, kxx=-DIE.kxx)
    plant, own = Plant(DIE, Hidden(cubic_stiffness_x=-1e14)), rows(unstable, Hidden(), 1, frequency=np.full(1, 1.9e4))
    own = replace(own, swing=np.array([[1e-3], [0.0]]))
    with pytest.raises(RuntimeError, match="no settled motion"):
        steady(plant, own, np.zeros(1), np.full(1, 2 * np.pi / 1.9e4))


def test_a_resonator_lives_on_one_axis():
    die = Die.resonator(68.6, 11.0, 0.98)
    record = done(Multisine("multisine", samples=512), Hidden(cubic_stiffness_x=3.9 * die.kxx), die)
    linear = done(Multisine("multisine", samples=512), die=die)
    assert record.clean.shape == (512, 1)
    spectrum = np.fft.rfft(linear.columns["u [V]"])
    w, w0 = 2 * np.pi * np.fft.rfftfreq(512, 16384 / 1e7), 2 * np.pi * 68.6
    settled = np.fft.irfft(spectrum * 0.98 * w0**2 / (w0**2 - w**2 + 1j * w * w0 / 11.0), 512)
    # The input has been on for 256 samples before the record: of the start, e^(-950 ms / 51 ms) is left.
    np.testing.assert_allclose(linear.clean[-190:, 0], settled[-190:], atol=2e-9)
    assert np.std(record.clean - linear.clean) > 0.02 * np.std(linear.clean)


def test_a_case_is_the_same_every_time_and_its_noise_is_the_declared_one(tmp_path):
    protocol = Laboratory((replace(SWEEP, points=40), Raw("raw", samples=300)))
    cases = [make_case(tmp_path / f"{k}" / "case", DIE, visible("cubic_stiffness_x"), 5, protocol) for k in (0, 1)]
    for name in ("sweep.csv", "raw.csv", "case.toml"):
        assert (cases[0].folder / name).read_bytes() == (cases[1].folder / name).read_bytes()
    table = np.loadtxt(cases[0].folder / "sweep.csv", delimiter=",", skiprows=1)
    measured = table[:, 2::2] + 1j * table[:, 3::2]
    noise = (measured - cases[0].records["sweep"].clean).view(float)
    assert np.std(noise) == pytest.approx(SWEEP.noise, rel=0.12)  # 640 numbers, four standard deviations


@pytest.mark.parametrize("case", ["P1", "P2", "P3", "P4", "P5"])
def test_the_bench_s_records_are_explained_by_their_truth(shared, case):
    folder = shared / "data" / "cases" / case
    t = json.loads((shared / "data" / "truth" / f"{case}.json").read_text())["true_parameters"]
    names = ("kxx", "kyy", "kxy", "dxx", "dyy", "dxy", "Phix", "Phiy")
    die = Die(1 / t["minv"], *(t[name] for name in names))
    hidden = Hidden(  # there, newtons are nN, lengths µm, dyx and dxy change places, and couplings do not drift
        cubic_stiffness_x=1e12 * t["k3x"], cross_damping_asymmetry=t["ddxy"], readout_delay=t["tau"],
        electrical_feedthrough_x_to_x=1e9 * t["ftxx"], electrical_feedthrough_x_to_y=1e9 * t["ftxy"],
        thermal_drift_stiffness=t["akT"], thermal_drift_damping=t["adT"],
    )  # fmt: skip
    plant = Plant(die, hidden)
    for name, condition in (("sweep_x", "swing"), ("soak", "temperature")):
        table = np.loadtxt(folder / f"{name}.csv", delimiter=",", skiprows=1)
        w, force = 2 * np.pi * table[:, 1], np.full(len(table), 2e-8)
        conditions = {"temperature": table[:, 0] - 25.0} if condition == "temperature" else {}
        if condition == "swing":
            force = 1e-9 * table[:, 0]
        own = rows(die, hidden, len(w), frequency=w, swing=np.stack([force, 0 * force]), **conditions)
        start, end = -np.pi / w, np.pi / w
        clean = cycle_phasors(plant, steady(plant, own, start, end), start, end, own)
        misfit = np.abs(table[:, 2::2] + 1j * table[:, 3::2] - clean) / 6.324555320336759e-05
        np.testing.assert_allclose(np.mean(misfit**2, axis=0) / 2, 1.0, atol=4 / np.sqrt(len(w)))
