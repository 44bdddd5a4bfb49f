"""Classic control against the sampled periodic steady state, transfer functions and stability by linear algebra."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from harness import Keep, run_kept
from oracles import classic
from scipy import optimize

import memsgyro_jax as mg
from memsgyro_jax.app.study.classic import entries_of_classic
from memsgyro_jax.loop import noise
from memsgyro_jax.loop.controllers import rebalance_design
from memsgyro_jax.loop.controllers.classic import locked_frequency
from memsgyro_jax.loop.separate_loops import separate_margins
from memsgyro_jax.loop.settling import not_rested


RATE = np.radians(100.0)
PERIOD = 5e-6
SPLIT = mg.SingleMassGyro.from_modes(
    1e-8, (10e3, 10.3e3), (2000.0, 300.0), quadrature=np.radians(200.0), cross_damping=0.01
)
MATCHED = mg.SingleMassGyro.from_modes(1e-8, (10e3, 10e3), (2000.0, 300.0), cross_damping=-0.02)
SHARP = mg.SingleMassGyro.from_modes(1.8e-8, (15e3, 15.2e3), (5000.0, 5000.0))
TWO_MASSES = mg.DualMassGyro.from_modes(3e-8, 2e-8, (9e3, 8.6e3), (900.0, 200.0), quadrature=0.5)
DISPLACEMENT = mg.ChargeAmplifier.chi2010(0.0)
VELOCITY = mg.DirectReadout.of_velocity((7.0, -5.0), 0.0)
LOOPS = {
    "open": (SPLIT, DISPLACEMENT, mg.ClassicControl.open_loop),
    "open, matched, of velocity": (MATCHED, VELOCITY, mg.ClassicControl.open_loop),
    "open, two masses": (TWO_MASSES, DISPLACEMENT, mg.ClassicControl.open_loop),
    "rebalanced": (SPLIT, DISPLACEMENT, mg.ClassicControl.force_rebalance),
    "rebalanced, matched, of velocity": (MATCHED, VELOCITY, mg.ClassicControl.force_rebalance),
    "rebalanced, two masses": (TWO_MASSES, DISPLACEMENT, mg.ClassicControl.force_rebalance),
}


def test_amplitudes_and_bandwidths_are_read_with_their_units():
    kinds = mg.ClassicControl.open_loop, mg.ClassicControl.force_rebalance
    for make, name in zip(kinds, ("bandwidth", "demodulator_bandwidth"), strict=True):
        text = make(SPLIT, DISPLACEMENT, amplitude="1 um", drive_bandwidth="0.4 kHz", **{name: "100 Hz"})
        plain = make(SPLIT, DISPLACEMENT, amplitude=1e-6, drive_bandwidth=400.0, **{name: 100.0})
        for one, other in zip(jax.tree.leaves(text), jax.tree.leaves(plain), strict=True):
            np.testing.assert_allclose(one, other, rtol=1e-12)
    with pytest.raises(mg.InputError, match="Argument `demodulator_bandwidth`"):
        mg.ClassicControl.force_rebalance(SPLIT, DISPLACEMENT, amplitude=1e-6, demodulator_bandwidth="3 V")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("modes", "quality"),
    [((17.2e3, 17.65e3), (6000, 1500)), ((25e3, 24.2e3), (2000, 20_000)), ((3e3, 3.2e3), (90, 40))],
)
def test_the_demodulator_left_out_filters_the_split(modes, quality):
    gyro = mg.SingleMassGyro.from_modes(1.5e-8, modes, quality, quadrature=np.radians(50.0))
    ways = [{}, {"demodulator_bandwidth": 0.05 * modes[0]}]
    chosen, wide = (
        mg.gain_phase_margins(
            loop_of(gyro, DISPLACEMENT, mg.ClassicControl.force_rebalance(gyro, DISPLACEMENT, amplitude=1e-6, **way))
        )
        for way in ways
    )
    assert chosen.crossover[2] > 1.1 * wide.crossover[2]
    assert min(float(chosen.distance.rate), float(wide.distance.rate) + 0.1) > 0.6
    assert chosen.phase_margin[2] > 70.0


def loop_of(gyro, readout, control):
    return mg.ClosedLoop(gyro, readout, mg.NoObserver.for_device(gyro, readout), control, start=(0.0,) * 4)


def settled(loop, rate, duration=0.3):
    """Frequency, force, rate and quadrature at the end of a run from rest."""
    trace = mg.simulate(loop, rate, sample_rate=1.0 / PERIOD, duration=duration, decimation=round(duration / PERIOD))
    told = trace.readings
    return jnp.stack([told.frequency[-1], told.force[-1], trace.rate_estimate[-1], told.quadrature[-1]])


@pytest.mark.parametrize(
    "name", [name if n in (0, 5) else pytest.param(name, marks=pytest.mark.slow) for n, name in enumerate(LOOPS)]
)
def test_the_steady_state_and_its_slope_are_those_of_linear_algebra(name):
    gyro, readout, make = LOOPS[name]
    control = make(gyro, readout, amplitude=1e-6)
    nulled = isinstance(control.sense, mg.ForceRebalance)
    run = jax.jit(lambda rate: settled(loop_of(gyro, readout, control), rate, 0.5))
    value, slope = jax.jvp(run, (RATE,), (1.0,))
    conversion = complex(*map(float, control.sense.conversion))
    near = float(locked_frequency(gyro, nulled=nulled)) / (2.0 * np.pi)

    def expected(rate):
        return np.array(classic.steady(gyro, rate, PERIOD, 1e-6, conversion, nulled, near, "velocity" in name))

    sizes = np.array([near, 1e-8, 1.0, 1.0])
    assert np.asarray(value) / sizes == pytest.approx(expected(RATE) / sizes, rel=1e-9, abs=1e-9)
    h = 4.0
    differences = [(expected(RATE + n * h) - expected(RATE - n * h)) / (2 * n * h) for n in (1, 2)]
    wanted = (4.0 * differences[0] - differences[1]) / 3.0
    assert np.asarray(slope) / sizes == pytest.approx(wanted / sizes, rel=1e-9, abs=1e-9)


PLAIN = mg.SingleMassGyro.from_modes(1e-8, (10e3, 10.3e3), (2000.0, 300.0))  # no quadrature, no cross damping


STEPPED = (  # and a quarter of the drive's period in samples
    (PLAIN, 5),
    (mg.SingleMassGyro.from_modes(5e-9, (12.5e3, 12.1e3), (900.0, 120.0)), 4),
    (mg.SingleMassGyro.from_modes(3e-8, (6.25e3, 6.25e3), (1500.0, 60.0)), 8),
)
BEFORE, AFTER = 24_000, 24_000  # samples


def stack(trees):
    return jax.tree.map(lambda *leaves: jnp.stack(leaves), *trees)


def steps(gyros, controls, quarters):
    """What comes out after a step of the rate, per its size and to first order, one row for each device: the mean of
    two steps a quarter of a period apart, in which what turns at twice the drive cancels.
    """

    def run(gyro, control, later, size):
        rate = mg.Step((BEFORE + later) * PERIOD, size)
        loop, duration = loop_of(gyro, DISPLACEMENT, control), (BEFORE + AFTER + 8) * PERIOD
        return mg.simulate(loop, rate, sample_rate=1.0 / PERIOD, duration=duration).rate_estimate

    def found(gyro, control, later):
        out = jax.jvp(lambda size: run(gyro, control, later, size), (0.0,), (1.0,))[1]
        return jax.lax.dynamic_slice(out, (BEFORE + later,), (AFTER,))

    both = jax.vmap(lambda g, c, q: 0.5 * (found(g, c, 0 * q) + found(g, c, q)))
    return np.asarray(both(stack(gyros), stack(controls), jnp.asarray(quarters)))


def transfer(answer, frequency):
    """Of a step's answer: the transform of its slope, the rate held over a sample."""
    turns = np.exp(-2j * np.pi * frequency * PERIOD * (np.arange(len(answer)) + 0.5))
    return turns @ np.diff(answer, prepend=0.0)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("make", "bandwidth"), [(mg.ClassicControl.open_loop, 1000.0), (mg.ClassicControl.force_rebalance, 15.0)]
)
def test_step_bandwidth_and_transfer_are_those_of_the_sampled_transfer_function(make, bandwidth):
    gyros, quarters = zip(*STEPPED, strict=True)
    fast = {"drive_bandwidth": 1000.0}  # soon settled
    controls = [make(gyro, DISPLACEMENT, amplitude=1e-6, bandwidth=bandwidth, **fast) for gyro in gyros]
    nulled = isinstance(controls[0].sense, mg.ForceRebalance)
    for gyro, control, answer in zip(gyros, controls, steps(gyros, controls, quarters), strict=True):
        conversion, near = complex(*map(float, control.sense.conversion)), float(control.drive.frequency)
        locked = 2 * np.pi * classic.steady(gyro, 0.0, PERIOD, 1e-6, conversion, nulled, near, velocity=False)[0]

        def wanted(frequency, gyro=gyro, control=control, locked=locked):
            return classic.rate_response(gyro, locked, PERIOD, control, frequency)

        expected = classic.step_response(gyro, locked, PERIOD, control, 4 * AFTER if nulled else 2 * AFTER)
        np.testing.assert_allclose(answer, expected[:AFTER], atol=1e-6)
        answer = np.append(answer, expected[AFTER:])  # the slowest pole has some left
        for frequency in (1e-3, 10.0, 100.0, 400.0):
            assert transfer(answer, frequency) == pytest.approx(wanted(frequency), abs=1e-6)
        edges = [
            optimize.brentq(lambda f, of=of: abs(of(f)) - abs(of(1e-3)) / np.sqrt(2.0), 1.0, 3000.0, xtol=1e-9)
            for of in (lambda f, answer=answer: transfer(answer, f), wanted)
        ]
        assert edges[0] == pytest.approx(edges[1], rel=1e-6)


def designs(count, seed):
    """Random devices with their rebalanced control, their sense axis split by 1.6 to 4 %, which a demodulator of a
    twentieth of the drive's frequency does not close around, without coupling.
    """
    rng = np.random.default_rng(seed)
    made = []
    for _ in range(count):
        low, split = rng.uniform(7e3, 11e3), rng.uniform(0.016, 0.04) * rng.choice([-1.0, 1.0])
        quality = 10.0 ** rng.uniform([2.7, 2.0], [3.7, 2.7])
        gyro = mg.SingleMassGyro.from_modes(rng.uniform(0.5e-8, 2e-8), (low, low * (1.0 + split)), tuple(quality))
        width = {"amplitude": 1e-6, "demodulator_bandwidth": 0.05 * low}
        made.append((gyro, mg.ClassicControl.force_rebalance(gyro, DISPLACEMENT, **width)))
    return made


@pytest.mark.parametrize("split", [0.0, 1e-4, -0.005, 0.012, -0.024])
@pytest.mark.parametrize("quality", [200.0, 50_000.0])
def test_loops_that_close_around_a_split_bear_dies_whose_modes_cross(split, quality):
    """By eigenvalues of the sampled loop, and by the margins of the averaged one."""
    away = 2.0 * np.pi * 12e3 * max(abs(split), 1e-4)
    design = mg.SingleMassGyro.from_modes(1e-8, (12e3, 12e3 * (1.0 + split)), (3000.0, quality))
    control = mg.ClassicControl.force_rebalance(design, DISPLACEMENT, amplitude=1e-6)
    assert mg.gain_phase_margins(loop_of(design, DISPLACEMENT, control)).distance.rate > 0.7
    for share in (-1.0, 0.0, 0.5, 1.0, 1.3):
        die = mg.SingleMassGyro.from_modes(1e-8, (12e3, 12e3 * (1.0 + share * split)), (3000.0, quality))
        omega = 2.0 * np.pi * float(control.drive.frequency)
        slowest = -np.log(classic.rebalance_growth(die, omega, PERIOD, control.sense)) / PERIOD
        assert slowest > 20.0, "comes to rest within a twentieth of a second"
        assert float(mg.loop_margins(loop_of(die, DISPLACEMENT, control)).rate) > 0.5
    assert float(control.sense.demodulator.bandwidth) * 2.0 * np.pi > away / 0.2


def test_a_tuned_demodulator_keeps_the_phase_that_its_gains_were_made_for(tmp_path):
    """Written to a study and read again, though the narrower one would have asked for another phase."""
    (tmp_path / "study.toml").write_text(
        '[device]\nkind = "single_mass"\nmass = "10 ug"\nfrequency = ["12 kHz", "12.1 kHz"]\n'
        'quality_factor = [3000, 800]\n[controller]\nkind = "classic"\nsense = "rebalanced"\n'
    )
    study = mg.load_study(tmp_path / "study.toml")
    control = study.loop.controller
    assert 1.0 < float(control.sense.turn) < 0.5 * np.pi
    narrow = eqx.tree_at(lambda made: made.sense.demodulator.bandwidth, control, jnp.asarray(300.0))
    again = study.changed(entries_of_classic(narrow)).loop.controller
    for one, other in zip(jax.tree.leaves(narrow), jax.tree.leaves(again), strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-9)


def test_a_bandwidth_below_the_split_wants_a_narrow_demodulator():
    near = mg.SingleMassGyro.from_modes(1e-8, (12e3, 12.1e3), (3000.0, 800.0))
    slow = mg.ClassicControl.force_rebalance(near, DISPLACEMENT, amplitude=1e-6, bandwidth="5 Hz")
    assert float(slow.sense.demodulator.bandwidth) < 100.0 / 0.2
    found = mg.gain_phase_margins(loop_of(near, DISPLACEMENT, slow))
    assert (found.crossover[2], found.distance.rate > 0.5) == (pytest.approx(5.0, rel=0.1), True)
    with pytest.raises(mg.InputError, match=r"80.3 Hz or more .* 100.4 Hz apart"):
        mg.ClassicControl.force_rebalance(
            near, DISPLACEMENT, amplitude=1e-6, bandwidth="5 Hz", demodulator_bandwidth="600 Hz"
        )


def scaled(control, **factors):
    """The control with some numbers multiplied, `sense.integral` as `sense_integral`."""
    places = [name.split("_", 1) for name in factors]
    values = [getattr(getattr(control, part), field) for part, field in places]
    new = [value * factor for value, factor in zip(values, factors.values(), strict=True)]
    return eqx.tree_at(lambda c: [getattr(getattr(c, part), field) for part, field in places], control, new)


def with_rebalance(control, factor):
    names = ("gain", "integral", "quadrature_gain", "quadrature_integral")
    return scaled(control, **{f"sense_{name}": factor for name in names})


def restlessness(gyros, controls, rate):
    """Standard deviation of rate, frequency and amplitude over the last tenth of a run, over their sizes, die by die;
    infinite for one that was lost.
    """

    def one(gyro, control):
        loop = mg.ClosedLoop(
            gyro, DISPLACEMENT, mg.NoObserver.for_device(gyro, DISPLACEMENT), control, start=(0.0,) * 4
        )
        trace = mg.simulate(loop, rate, sample_rate=1.0 / PERIOD, duration=0.5, decimation=50)
        told = (trace.rate_estimate / rate, trace.readings.frequency / 1e4, trace.readings.amplitude / 1e-6)
        lost = jnp.isfinite(trace.intact_until)
        return jnp.stack([jnp.where(lost, jnp.inf, jnp.std(part[-200:])) for part in told])

    return np.asarray(jax.vmap(one)(stack(gyros), stack(controls))).T


@pytest.mark.slow
@pytest.mark.parametrize("count", [2, pytest.param(50, marks=pytest.mark.slow)])
def test_gains_are_stable_in_the_simulation_where_they_are_by_formula_and_not_beyond(count):
    made = designs(count, seed=7)
    gyros, critical = [], []
    for gyro, control in made:
        near = float(control.drive.frequency)
        turning = 2.0 * np.pi * classic.steady(gyro, 0.0, PERIOD, 1e-6, 1.0, True, near, velocity=False)[0]

        def growth(factor, gyro=gyro, control=control, turning=turning):
            return classic.rebalance_growth(gyro, turning, PERIOD, with_rebalance(control, factor).sense) - 1.0

        top = next(f for f in 1.2 ** np.arange(99) if growth(f) > 0.0)
        critical.append(optimize.brentq(growth, 0.05, top))
        gyros.append(gyro)
    inside, outside = (
        [with_rebalance(control, share * edge) for (_, control), edge in zip(made, critical, strict=True)]
        for share in (0.85, 1.15)
    )
    calm = restlessness(gyros, inside, RATE)[0]
    wild = restlessness(gyros, outside, RATE)[0]
    assert np.all(calm < 1e-2)
    assert np.all(wild > 0.1)
    for gyro, stable, unstable in zip(gyros, inside, outside, strict=True):
        assert float(mg.loop_margins(loop_of(gyro, DISPLACEMENT, stable)).rate) > 0.0
        assert float(mg.loop_margins(loop_of(gyro, DISPLACEMENT, unstable)).rate) < 0.0


@pytest.mark.slow
def test_the_drive_loops_are_stable_where_their_characteristic_polynomials_are():
    """s (s + d/2)(s + b) + b (k s + i) is stable where i < (b + d/2)(k + d/2), the amplitude's gains per force."""
    gyro, control = designs(1, seed=3)[0]
    drive, omega = control.drive, 2.0 * np.pi * float(control.drive.frequency)
    pole, decay = 2.0 * np.pi * float(drive.demodulator.bandwidth), 0.5 * float(gyro.dxx / gyro.mass)
    grow = 1.0 / (2.0 * omega * float(gyro.mass))
    edges = {
        "drive_phase_integral": (pole + decay) * (float(drive.phase_gain) + decay) / float(drive.phase_integral),
        "drive_force_integral": (pole + decay) * (float(drive.force_gain) + decay / grow) / float(drive.force_integral),
    }
    controls = [scaled(control, **{name: share * edge}) for name, edge in edges.items() for share in (0.8, 1.25)]
    _, frequency, amplitude = restlessness([gyro] * 4, controls, RATE)
    assert frequency[0] < 1e-6 < 1e-4 < frequency[1]
    assert amplitude[2] < 1e-6 < 1e-3 < amplitude[3]
    margins = [mg.loop_margins(loop_of(gyro, DISPLACEMENT, tried)) for tried in controls]
    assert [float(margin.phase) > 0.0 for margin in margins] == [True, False, True, True]
    assert [float(margin.amplitude) > 0.0 for margin in margins] == [True, True, True, False]


def test_a_bandwidth_that_the_sense_axis_does_not_bear_is_refused(monkeypatch):
    def rebalanced(bandwidth):
        widths = {"bandwidth": bandwidth, "demodulator_bandwidth": 500.0}
        return mg.ClassicControl.force_rebalance(SHARP, DISPLACEMENT, amplitude=1e-6, **widths)

    with pytest.raises(mg.InputError, match=r"at 3 Hz it grows by .* 1/s: the axes are 200 Hz apart"):
        rebalanced(3.0)
    borne = optimize.brentq(lambda tried: 0.5 - refused(rebalanced, tried), 0.1, 3.0, xtol=0.01)
    monkeypatch.setattr(rebalance_design, "_check_stable", lambda *numbers: None)
    margins = [float(mg.loop_margins(loop_of(SHARP, DISPLACEMENT, rebalanced(s * borne))).rate) for s in (0.9, 1.1)]
    assert margins[0] > 0.0 > margins[1]


def refused(make, number):
    try:
        make(number)
    except mg.InputError:
        return True
    return False


def test_the_margin_is_a_loss_with_a_slope():
    """Where the axes do not couple, the distances are those of the formulas; a lot has a margin for each die."""
    gyro, control = designs(1, seed=3)[0]
    loss = mg.losses.Weighted((mg.losses.LoopMargin(0.9), 2.0))

    def loops(factor):
        return loop_of(gyro, DISPLACEMENT, with_rebalance(control, factor))

    found, slope = jax.jvp(lambda factor: loss.of_loop(loops(factor)), (1.2,), (1.0,))
    margins = separate_margins(loops(1.2))
    assert float(found) == pytest.approx(2.0 * sum(max(0.0, 1.0 - float(m) / 0.9) ** 2 for m in margins), rel=1e-12)
    assert float(found) > 0.0
    beside = separate_margins(loops(np.array([1.2 + 1e-5, 1.2 - 1e-5])))
    ends = 2.0 * sum(np.maximum(0.0, 1.0 - np.asarray(m) / 0.9) ** 2 for m in beside)
    assert float(slope) == pytest.approx((ends[0] - ends[1]) / 2e-5, rel=1e-4)
    np.testing.assert_allclose(mg.loop_margins(loops(1.2)), margins, rtol=0.01)
    np.testing.assert_allclose(margins, classic.margins(gyro, with_rebalance(control, 1.2)), rtol=0.01)
    with pytest.raises(mg.InputError, match="driven by `ClassicControl`"):
        mg.loop_margins(mg.default_study().loop)


def test_a_gain_margin_is_where_a_loop_begins_to_oscillate():
    gyro, control = designs(1, seed=3)[0]
    found = mg.gain_phase_margins(loop_of(gyro, DISPLACEMENT, control))
    assert np.isfinite(found.increase[2])
    assert f"{found.phase_margin[0]:.3g}°" in str(found)
    rate, quadrature = ("gain", "integral"), ("quadrature_gain", "quadrature_integral")
    for names, margin in ((rate, found.increase[2]), (rate + quadrature, found.increase[4])):
        for share, stable in ((0.99, True), (1.01, False)):
            times = share * 10.0 ** (margin / 20.0)
            made = {name: times * getattr(control.sense, name) for name in names}
            louder = dataclasses.replace(control, sense=dataclasses.replace(control.sense, **made))
            assert bool(mg.loop_margins(loop_of(gyro, DISPLACEMENT, louder)).rate > 0.0) is stable
    assert found.increase[4] < found.increase[2]
    drive, decay = control.drive, 0.5 * float(gyro.dxx / gyro.mass)
    s = 2j * np.pi * found.crossover[0]
    pole = 2.0 * np.pi * float(drive.demodulator.bandwidth)
    loop = (float(drive.phase_gain) + float(drive.phase_integral) / s) / (s + decay) * pole / (s + pole)
    assert abs(loop) == pytest.approx(1.0, rel=0.05)
    assert 180.0 - abs(np.degrees(np.angle(loop))) == pytest.approx(found.phase_margin[0], abs=3.0)


def test_a_gain_margin_ends_where_the_averaged_loops_do():
    """Loops that bear any gain when averaged are stable in simulations up to what is told, and not at any gain."""
    gyro = mg.SingleMassGyro.from_modes("20 ug", ("9 kHz", "9.0002 kHz"), 50000)
    control = mg.ClassicControl.force_rebalance(gyro, DISPLACEMENT, amplitude=1e-6)
    found = mg.gain_phase_margins(loop_of(gyro, DISPLACEMENT, control))
    assert np.all(np.isinf(found.increase))
    assert np.all((found.known_to > 20.0) & (found.known_to < 30.0))
    assert "> 25 dB" in str(found)
    assert "a tenth of the drive's frequency" in str(found)
    up = [loop["gain_margin_up_db"] for loop in found.as_dict().values()]
    above = [loop["gain_margin_up_above_db"] for loop in found.as_dict().values()]
    assert (up, above) == ([None] * 5, found.known_to.tolist())
    names = ("gain", "integral", "quadrature_gain", "quadrature_integral")
    ends = []
    for change in (found.known_to[4], 48.0):
        made = {name: 10.0 ** (change / 20.0) * getattr(control.sense, name) for name in names}
        louder = dataclasses.replace(control, sense=dataclasses.replace(control.sense, **made))
        loop = dataclasses.replace(loop_of(gyro, DISPLACEMENT, louder), start=(1e-6, 0.0, 0.0, 0.0))
        trace = mg.simulate(loop, 0.1, sample_rate=100e3, duration=0.2, decimation=20)
        ends.append((np.std(trace.rate_estimate[trace.time > 0.15]), trace.intact_until < 0.2))
    assert ends[0][0] < 1e-4
    assert [lost for _, lost in ends] == [False, True]


def test_a_loop_beyond_the_averaged_model_has_no_known_margin():
    gyro = mg.SingleMassGyro.from_modes("20 ug", ("9 kHz", "9.0002 kHz"), 50000)
    control = mg.ClassicControl.force_rebalance(gyro, DISPLACEMENT, amplitude=1e-6)
    names = ("gain", "integral", "quadrature_gain", "quadrature_integral")
    made = {name: 30.0 * getattr(control.sense, name) for name in names}
    louder = dataclasses.replace(control, sense=dataclasses.replace(control.sense, **made))
    found = mg.gain_phase_margins(loop_of(gyro, DISPLACEMENT, louder))
    assert found.known_to[2] < 0.0
    assert "as it is: rate, quadrature, rate and quadrature together" in str(found)
    assert "unknown" in str(found)
    assert found.as_dict()["rate"]["gain_margin_up_above_db"] is None


def test_a_run_that_ends_before_its_loops_rest_says_so():
    """A high-Q sense axis near the drive leaves rebalance loops of a wide demodulator a time constant of a second."""
    gyro = mg.SingleMassGyro.from_modes("8 ug", ("10 kHz", "10.06 kHz"), 8000, quadrature="200 deg/s")
    control = mg.ClassicControl.force_rebalance(gyro, DISPLACEMENT, amplitude=1e-6, demodulator_bandwidth="250 Hz")
    loop = loop_of(gyro, DISPLACEMENT, control)
    assert "time constant of 0.8" in not_rested(loop, 0.5)[0]
    assert not_rested(loop, 5.0) == ()
    broken = eqx.tree_at(lambda one: one.device.kxx, loop, jnp.nan)
    assert not_rested(broken, 0.5) == ()


def test_a_run_that_ends_before_its_loops_rest_names_what_is_slow(caplog, monkeypatch):
    """A drive that swings up in 0.26 s, behind which a demodulator of 125 times the split has nothing to gain."""
    gyro = mg.SingleMassGyro.from_modes("1 mg", ("5 kHz", "5.002 kHz"), (80000, 80000), quadrature="2 deg/s")
    control = mg.ClassicControl.force_rebalance(gyro, DISPLACEMENT, amplitude=2e-6)
    loop = loop_of(gyro, DISPLACEMENT, control)
    (said,) = not_rested(loop, 0.3)
    assert "after the 0.26 s in which the drive swings up" in said
    assert "0.35 s and more outlast. A larger `limit` of the drive's force" in said
    assert "sense axis" not in said
    from_above = eqx.tree_at(lambda one: one.start[0], loop, 2e-5)
    (said,) = not_rested(from_above, 0.3)
    assert "in which the swing comes down from its start at 2e-05 m" in said
    assert "A `start` at rest, (0, 0, 0, 0), or with the drive's amplitude needs none of it." in said
    apart = mg.SingleMassGyro.from_modes("8 ug", ("10 kHz", "10.06 kHz"), 8000, quadrature="200 deg/s")
    slow = mg.ClassicControl.force_rebalance(apart, DISPLACEMENT, amplitude=1e-6, demodulator_bandwidth="250 Hz")
    assert "a demodulator of five times the mode split" in not_rested(loop_of(apart, DISPLACEMENT, slow), 0.5)[0]
    monkeypatch.setattr("memsgyro_jax.loop.settling._SAID", set())
    for change in (1.0, 1.001):  # a loop over parameters
        mg.simulate(loop, 0.1 * change, sample_rate=130e3, duration=2e-3)
    assert caplog.text.count("it shows their start") == 1


def test_coupled_axes_make_a_slow_drive_unstable():
    """Holding y still moves the resonance of the thesis' drive by 107 Hz."""
    gyro = mg.SingleMassGyro.chi2010()
    for width, stable in ((None, True), (100.0, False)):
        control = mg.ClassicControl.force_rebalance(gyro, DISPLACEMENT, amplitude=1e-6, drive_bandwidth=width)
        assert [float(one) > 0.0 for one in mg.loop_margins(loop_of(gyro, DISPLACEMENT, control))] == [stable] * 4


@pytest.mark.slow
def test_coupled_loops_settle_where_their_margins_say():
    """Modes turned against the axes: about the width at which the margin vanishes."""
    made = (
        ((15e3, 17e3), (1000.0, 200.0), 0.25),
        ((11e3, 9.6e3), (500.0, 150.0), 0.3),
        ((10e3, 11.3e3), (700.0, 130.0), -0.35),
    )
    gyros = [mg.SingleMassGyro.from_modes(3e-9, modes, quality, angle=angle) for modes, quality, angle in made]

    def control(gyro, width):
        return mg.ClassicControl.force_rebalance(gyro, DISPLACEMENT, amplitude=1e-6, drive_bandwidth=width)

    def least(gyro, width):
        return float(mg.loop_margins(loop_of(gyro, DISPLACEMENT, control(gyro, width))).least)

    edges = [optimize.brentq(lambda width, gyro=gyro: least(gyro, width), 80.0, 640.0, rtol=1e-3) for gyro in gyros]
    for share, stable in ((0.75, False), (1.6, True)):
        _, frequency, _ = restlessness(gyros, [control(g, share * e) for g, e in zip(gyros, edges, strict=True)], RATE)
        assert np.all(frequency < 1e-6 if stable else frequency > 1e-4)


@pytest.mark.slow
@pytest.mark.parametrize("make", [mg.ClassicControl.open_loop, mg.ClassicControl.force_rebalance])
def test_products_give_the_steady_state_up_to_their_ripple(make):
    control = make(SPLIT, DISPLACEMENT, amplitude=1e-6)
    nulled, conversion = isinstance(control.sense, mg.ForceRebalance), complex(*map(float, control.sense.conversion))
    where = lambda c: (c.drive.demodulator, c.sense.demodulator)  # noqa: E731
    widths = [float(part.bandwidth) for part in where(control)]
    control = eqx.tree_at(where, control, tuple(mg.ProductDemodulator(width, 2) for width in widths))
    trace = mg.simulate(loop_of(SPLIT, DISPLACEMENT, control), RATE, sample_rate=1.0 / PERIOD, duration=0.5)
    told, late = trace.readings, slice(-20_000, None)
    found = np.array([part[late] for part in (told.frequency, told.force, trace.rate_estimate, told.quadrature)])
    wanted = classic.steady(SPLIT, RATE, PERIOD, 1e-6, conversion, nulled, 10e3, velocity=False)
    ripple = np.ptp(found, axis=1)
    # Integrals smooth the outputs, but not what the drive's ripple, as a share of its amplitude, does to their mean.
    assert np.all(np.abs(found.mean(axis=1) - wanted) < np.maximum(ripple, (widths[0] / 20e3) ** 2 * np.abs(wanted)))
    assert np.all(ripple < [3.0, 1e-8, 0.5, 0.5])
    if not nulled:  # a second-order low-pass leaves (b/2f)² of the product, of either sign
        left = (widths[1] / 20e3) ** 2 * np.hypot(*wanted[2:])
        assert ripple[2] == pytest.approx(2.0 * left, rel=0.2)


@pytest.mark.slow
def test_a_bias_matches_the_modes_and_the_control_made_for_it_reads_the_rate():
    split = 0.005
    gyro = PLAIN.with_effect(mg.effects.ElectrostaticSoftening("y", 0.02))
    bias = mg.matching_bias(gyro, split)
    held = mg.at_bias(gyro, bias)
    assert np.sqrt(held.kyy / held.kxx) == pytest.approx(1.0 + split, rel=1e-12)
    assert float(bias) == pytest.approx(np.sqrt((PLAIN.kyy - PLAIN.kxx * 1.005**2) / 0.02), rel=1e-12)
    control = mg.ClassicControl.open_loop(held, DISPLACEMENT, amplitude=1e-6)
    unbiased = mg.ClassicControl.open_loop(PLAIN, DISPLACEMENT, amplitude=1e-6)
    gain = np.hypot(*unbiased.sense.conversion) / np.hypot(*control.sense.conversion)
    assert 5.0 < gain < 6.0  # 300 Hz of split have become 50
    scenario = mg.Scenario(rate=mg.Constant(RATE), bias_voltage=mg.Constant(bias))
    trace = mg.simulate(loop_of(gyro, DISPLACEMENT, control), scenario, sample_rate=1.0 / PERIOD, duration=0.15)
    # Effects act as kicks, whose share of a frequency is of second order in the period.
    assert float(trace.rate_estimate[-1]) == pytest.approx(RATE, rel=0.01)
    for refused, words in ((PLAIN, "no such effect"), (gyro, "a bias can soften")):
        with pytest.raises(mg.InputError, match=words):
            mg.matching_bias(refused, 0.1)


@pytest.mark.parametrize(
    ("make", "seconds"), [pytest.param("open_loop", 0.2, marks=pytest.mark.slow), ("force_rebalance", 0.6)]
)
def test_a_lot_far_from_its_design_starts(make, seconds):
    """The thesis' device at 15 %: each of 32 dies within the reach of the phase-locked loop holds its own resonance.

    Rebalanced, its drive must follow the 107 Hz by which the resonance moves as y is held, and the design's gains are
    stable only where the axes' own frequencies are a tenth apart.
    """
    gyro = mg.SingleMassGyro.chi2010()
    readout = mg.ChargeAmplifier.chi2010()
    control = getattr(mg.ClassicControl, make)(gyro, readout, amplitude=1e-6)
    loop = loop_of(gyro, readout, control).sampled_at(100e3, duration=seconds)
    drawn = mg.Spread.relative(0.15).draw(loop, mg.Scenario(), 0, np.arange(32)).loop.device
    dies = [jax.tree.map(lambda leaf, n=n: np.broadcast_to(leaf, 32)[n], drawn) for n in range(32)]
    nulled = make == "force_rebalance"
    own = np.array([float(locked_frequency(die, nulled=nulled)) for die in dies]) / (2.0 * np.pi)
    words = noise.die_words(jax.random.key(0), jnp.arange(32))
    batch = eqx.tree_at(lambda made: made.device, loop, drawn)
    keep = Keep(lambda sample: sample.rate, jnp.zeros(()))
    run = run_kept(batch, mg.Scenario(), words, 100e3, 20, round(5e3 * seconds), keep, loop)
    read = batch.estimate(run.state).readings
    near = np.abs(own / float(control.drive.frequency) - 1.0) < float(control.drive.pull)
    assert np.sum(near) >= 31
    if nulled:
        near &= np.sqrt(np.asarray(drawn.kyy / drawn.kxx)) > 1.1
        assert np.sum(near) == 26
    assert np.max(np.abs(own - float(control.drive.frequency))) > 500.0
    np.testing.assert_allclose(np.asarray(read.frequency)[near], own[near], atol=1.0)
    np.testing.assert_allclose(np.asarray(read.amplitude)[near], 1e-6, rtol=0.02)
