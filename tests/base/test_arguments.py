"""What a person passes to the public functions: text with units is taken, what cannot be meant is one sentence."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import memsgyro_jax as mg
from memsgyro_jax.base.arguments import quantity, whole
from memsgyro_jax.loop import trace


@pytest.fixture(scope="module")
def loop():
    return mg.default_study().loop


def refusal(function, *arguments, **options):
    with pytest.raises(mg.InputError) as caught:
        function(*arguments, **options)
    sentence = str(caught.value)
    assert sentence.isprintable()
    assert sentence.endswith(".")
    assert len(sentence) < 300
    return sentence


@pytest.mark.parametrize("seed", [-1, 2**63, 2**64, 1.5, float("nan"), float("inf"), "0", None, True, 10**400])
def test_a_seed_that_is_none(loop, seed):
    for run in (
        lambda: mg.simulate(loop, sample_rate=100e3, duration=1e-3, seed=seed),
        lambda: mg.sweep(loop, mg.Spread.relative(0.1), seed=seed),
        lambda: mg.tune(loop, free=mg.free(observer=("rate_noise",)), seed=seed),
        lambda: mg.design_motion(loop.device, seed=seed),
    ):
        words = "at least 0" if seed == -1 else "a whole number from 0 to 9223372036854775807"
        assert refusal(run).startswith(f"Argument `seed` must be {words}, but ")


@pytest.mark.parametrize("dies", [0, -3, 2.5, 1e20, 2**31, "many", None, True, 10**400])
def test_dies_that_are_none(loop, dies):
    assert "Argument `dies` must be " in refusal(mg.sweep, loop, mg.Spread.relative(0.1), dies=dies)
    free = mg.free(observer=("rate_noise",))
    assert "Argument `dies` must be " in refusal(mg.tune, loop, free=free, dies=dies)


@pytest.mark.parametrize("given", ["100", "100 kg", "fast", "", "1e400 Hz", "1,5 kHz", True, [1e5], {"value": 1}])
def test_a_sample_rate_that_is_none(loop, given):
    for run in (mg.simulate, mg.information_bound):
        assert "Argument `sample_rate`" in refusal(run, loop, 1.0, sample_rate=given, duration="1 ms")
    assert "Argument `sample_rate`" in refusal(mg.sweep, loop, mg.Spread.relative(0.1), sample_rate=given)


def test_a_device_is_no_loop(loop):
    for run in (
        lambda: mg.simulate(loop.device, sample_rate=100e3, duration=1e-3),
        lambda: mg.sweep(loop.device, mg.Spread.relative(0.1)),
        lambda: mg.tune(loop.device, free=()),
        lambda: mg.information_bound(loop.device),
    ):
        assert refusal(run).startswith("Argument `loop` must be a ClosedLoop, of device, read-out, observer")
        assert "but is a SingleMassGyro" in refusal(run)


def test_text_with_units_is_what_the_number_is(loop, monkeypatch):
    """Up to the compiled program, which this test spares."""
    given = []

    def compiled(loop, scenario, words, *settings):
        period, rows = settings
        given.append(((float(scenario.at(0.0).inertial.rate), period), rows))
        raise KeyboardInterrupt

    monkeypatch.setattr(trace, "_compiled", compiled)
    for scenario, sample_rate, duration in ((np.radians(30.0), 100e3, 1e-4), ("30 deg/s", "100 kHz", "0.1 ms")):
        with pytest.raises(KeyboardInterrupt):
            mg.simulate(loop, scenario, sample_rate=sample_rate, duration=duration)
    assert given[1][0] == pytest.approx(given[0][0], rel=1e-15)
    assert given[1][1] == given[0][1]
    assert "Argument `scenario`" in refusal(mg.simulate, loop, "30 Hz", sample_rate=100e3, duration=1e-4)


def test_quantities_and_counts():
    assert quantity("rate", "100 kHz", "Hz") == 100e3
    assert quantity("rate", "1 deg/s", "rad/s") == pytest.approx(np.pi / 180)
    assert quantity("rate", np.float32(2.0), "Hz") == 2.0
    assert jax.grad(lambda x: quantity("rate", x, "Hz") ** 2)(3.0) == 6.0
    assert whole("dies", 1e3, 1) == 1000
    assert whole("seed", 2**63 - 1) == 2**63 - 1
    assert whole("dies", jnp.asarray(7)) == 7
    assert jax.vmap(lambda die: whole("die", die) + 1)(jnp.arange(3)).tolist() == [1, 2, 3]


def test_constructors_take_units_as_text():
    tone = mg.Tone("0.6 kHz", 53.95, "180 deg")
    np.testing.assert_allclose([tone.frequency, tone.phase], [600.0, np.pi])
    gyro = mg.SingleMassGyro.from_modes("180 ug", ("2.9 kHz", 3700.0), 1000.0)
    np.testing.assert_allclose(mg.mode_frequencies(gyro), [2900.0, 3700.0])
    np.testing.assert_allclose(gyro.mass, 1.8e-7)
    for turned in ({"quadrature": "90 deg/s"}, {"quadrature": np.pi / 2}):
        coupled = mg.SingleMassGyro.from_modes("180 ug", ("2.9 kHz", 3700.0), 1000.0, **turned).at_temperature(
            "27 degC"
        )
        np.testing.assert_allclose(coupled.kxy, 1.8e-7 * 4 * np.pi * 2900.0 * np.pi / 2, rtol=1e-6)
        np.testing.assert_allclose(coupled.temperature, 300.15)
    assert mg.SingleMassGyro.from_modes(1e-8, (9e3, 8e3), 10.0, angle="45 deg").kxx == pytest.approx(
        mg.SingleMassGyro.from_modes(1e-8, (9e3, 8e3), 10.0, angle=np.pi / 4).kyy
    )
    two = mg.DualMassGyro.from_modes("26 ug", "16 ug", ("9 kHz", 8.6e3), 900.0, quadrature="45 deg/s")
    np.testing.assert_allclose([two.mass_x, two.kyx], [2.6e-8, 1.6e-8 * 4 * np.pi * 9e3 * np.pi / 4])
    circuit = {"bias": "10 V", "feedback": "1 pF", "noise_density": "0.45 uV/sqrt(Hz)"}
    readout = mg.ChargeAmplifier.from_gradient("5 nF/m", ("250 fF", 2e-13), **circuit)
    np.testing.assert_allclose(readout.scale, 2 * [-1e5])
    np.testing.assert_allclose([*readout.overlap, *readout.noise_density], [5e-5, 4e-5, 4.5e-7, 4.5e-7])
    assert mg.Lowpass("0.1 kHz").bandwidth == 100.0
    assert mg.Spread.relative("10 %") == mg.Spread.relative(0.1)
    assert mg.Uniform(relative="5 %").relative == 0.05
    np.testing.assert_allclose(mg.Step("20 ms", 1.0).at, 0.02)
    np.testing.assert_allclose(mg.Chirp(1.0, "10 Hz", "1 kHz", "0.1 s").high, 1000.0)
    prior = mg.design_prior(gyro, rate_std="180 deg/s", amplitude="1 um")
    np.testing.assert_allclose([prior.theta_std[0], prior.motion[0]], [np.pi, 1e-6])


def test_text_that_no_constructor_takes():
    assert "Argument `frequency`" in refusal(mg.Tone, "600 kg", 1.0)
    assert "whose unit follows from its use" in refusal(mg.Tone, 600.0, "53.95 m/s^2")
    assert "Argument `relative`" in refusal(mg.Spread.relative, "10 Hz")
    assert "Argument `mass`" in refusal(mg.SingleMassGyro.from_modes, "heavy", (2900.0, 3700.0), 1000.0)
    assert "whose unit follows from its use" in refusal(mg.DirectReadout, "100 mV/um")


FIRST = mg.OpenLoop()
NEEDS_SEVERAL = {
    "reference model": lambda given: mg.ReferenceModel(given),
    "energy control": lambda given: mg.EnergyControl(FIRST, given, (1e-6, 1e-6), 1.0),
    "energy observer": lambda given: mg.EnergyObserver(None, given, (1e-6, 1e-6)),
    "modes": lambda given: mg.SingleMassGyro.from_modes(1e-8, given, 1000.0),
}


@pytest.mark.parametrize("make", NEEDS_SEVERAL.values(), ids=NEEDS_SEVERAL)
def test_a_frequency_alone_where_there_must_be_two(make):
    for given in (21.9e3, "21.9 kHz", None, jnp.asarray(21.9e3)):
        assert refusal(make, given).startswith("Argument `frequency` must be ")
    assert "`frequency`" in refusal(make, ("fast", 3e3))
    assert "`frequency`" in refusal(make, ("3 kg", 3e3))


def test_several_numbers_are_read_as_one_is():
    np.testing.assert_allclose(mg.ReferenceModel(("3 kHz", 5000)).frequency, [3000.0, 5000.0])
    np.testing.assert_allclose(mg.EnergyControl(FIRST, (3e3, 5e3), ("1 um", 2e-6), 1.0).amplitude, [1e-6, 2e-6])
    np.testing.assert_allclose(mg.Saturated(FIRST, ("200 uN", 1e-4)).limit, [2e-4, 1e-4])


def test_what_is_no_tone():
    for given in (21.9e3, "600 Hz", (21.9e3, 600.0), ((mg.Tone(600.0, 1.0), 3.0), ())):
        assert refusal(mg.OpenLoop, given).startswith("Argument `tones` must be a `Tone(frequency, amplitude)`")


def test_an_angle_is_asked_for_at_a_frequency_with_its_unit():
    motion = (1e-6, 2e-6, 0.01, -0.02)
    assert mg.vibration_angle(motion, "3 kHz") == mg.vibration_angle(motion, 3000.0)
    for ask in (mg.vibration_angle, mg.vibration_ellipse):
        assert "Argument `frequency`" in refusal(ask, motion, "fast")
    rows = np.ones((10, 4))
    for ask in (mg.angle_by_lowpass, mg.angle_by_bandpass):
        assert "Argument `frequency`" in refusal(ask, rows, "3 kg", 1e5)


def test_numbers_that_a_constructor_makes_numbers_of():
    gyro, readout = mg.SingleMassGyro.chi2010(), mg.DirectReadout.of_velocity(5.0)
    tone = mg.Tone(600.0, 1.0)
    assert "`frequency`" in refusal(mg.SlidingMode.for_device, gyro, readout, tone, frequency="3 kHz")
    assert "`frequency`" in refusal(mg.LyapunovObserver.for_device, gyro, readout, frequency="fast")
    assert "`spread`" in refusal(mg.design_prior, gyro, spread="much")
    assert "`prior`" in refusal(mg.ExtendedKalmanFilter.for_device, gyro, prior=21.9e3)
    assert "`rows`" in refusal(mg.RandomWalk, 1.0, 1.0, rows="many")
    assert "`length`" in refusal(mg.BlockFilter.for_device, gyro, length=21.9e3)


def test_parts_of_a_loop_in_the_wrong_order(loop):
    device, readout, observer, controller = loop.device, loop.readout, loop.observer, loop.controller
    said = refusal(mg.ClosedLoop, device, observer, readout, controller)
    assert said.startswith(
        "Argument `readout` must be a read-out, but is an observer, of type ExtendedKalmanFilter, and"
    )
    assert "`observer` must be an observer, but is a read-out, of type ChargeAmplifier" in said
    assert "`device` must be a device" in refusal(mg.ClosedLoop, readout, device, observer, controller)
    assert "`controller` must be a controller" in refusal(mg.ClosedLoop, device, readout, observer, observer)
    assert "`observer`" in refusal(mg.ClosedLoop, device, readout, None, controller)
    assert "`discretisation`" in refusal(mg.ClosedLoop, device, readout, observer, controller, discretisation=3)


@pytest.mark.parametrize("given", [-1e5, 0.0, float("nan"), float("inf"), "-100 kHz"])
def test_a_sample_rate_that_is_not_positive_is_what_is_blamed(loop, given):
    for run in (mg.simulate, mg.information_bound):
        assert refusal(run, loop, 1.0, sample_rate=given, duration="1 ms").startswith("Argument `sample_rate` must be ")
    asked = {"sample_rate": given, "duration": "1 ms"}
    assert refusal(mg.frequency_response, loop, [1e4], **asked).startswith("Argument `sample_rate` must be ")
    assert refusal(mg.sweep, loop, mg.Spread.relative(0.1), **asked).startswith("Argument `sample_rate` must be ")
