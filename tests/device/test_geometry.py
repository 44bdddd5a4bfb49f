"""Components against a frame of beam elements, a film on a grid, and the closed forms of the literature."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from oracles.frame import film, frame
from scipy import optimize

import memsgyro_jax as mg
from memsgyro_jax import InputError, geometry
from memsgyro_jax.base.display import stated_at
from memsgyro_jax.montecarlo.spread import Root


YOUNG, THICK = 169e9, 20e-6
SILICON = {"thickness": THICK, "young": YOUNG}
sizes = st.floats(30e-6, 600e-6)


def matrix(stiffness):
    return np.array([[stiffness.xx, stiffness.xy], [stiffness.xy, stiffness.yy]])


@settings(max_examples=20)
@given(st.lists(st.tuples(sizes, st.floats(-3.0, 3.0)), min_size=1, max_size=6), st.floats(1e-6, 4e-6))
def test_polylines_are_frames(legs, width):
    points = [(0.0, 0.0)]
    for length, angle in legs:
        points.append((points[-1][0] + length * np.cos(angle), points[-1][1] + length * np.sin(angle)))
    found = matrix(geometry.polyline(points, width, **SILICON))
    expected = frame(points, width, **SILICON).real
    np.testing.assert_allclose(found, expected, rtol=1e-6, atol=1e-7 * np.abs(expected).max())


@pytest.mark.parametrize("seed", range(3))
def test_derivatives_by_complex_step(seed):
    points = np.cumsum(np.random.default_rng(seed).uniform(50e-6, 300e-6, (4, 2)), axis=0)
    slope = jax.jacfwd(lambda w: jnp.stack(geometry.polyline(points.tolist(), w, **SILICON)))(3e-6)
    step = frame(points, 3e-6 + 1e-30j, **SILICON).imag / 1e-30
    np.testing.assert_allclose(slope, [step[0, 0], step[1, 1], step[0, 1]], rtol=1e-9)


def test_beams_and_what_is_made_of_them():
    """Thesis (1.2), (1.3), (1.6); 10 % more thickness are 10 % more stiffness."""
    beam = geometry.Beam(length=200e-6, width=2e-6, **SILICON)
    a3b = YOUNG * (2e-6) ** 3 * THICK
    for found, expected in [
        (beam.cantilever, a3b / (4 * 200e-6**3)),
        (beam.guided, a3b / 200e-6**3),
        (beam.cantilever_across, YOUNG * 2e-6 * THICK**3 / (4 * 200e-6**3)),
        (beam.axial, YOUNG * 2e-6 * THICK / 200e-6),
    ]:
        assert found == pytest.approx(expected, rel=1e-12)
    inner = geometry.Beam(length=150e-6, width=2e-6, **SILICON)
    truss = geometry.in_series(2 * beam.guided, 2 * inner.guided)
    assert truss == pytest.approx(2 * a3b / (200e-6**3 + 150e-6**3), rel=1e-12)
    thicker = geometry.Beam(length=200e-6, width=2e-6, thickness=1.1 * THICK, young=YOUNG)
    assert thicker.guided / beam.guided == pytest.approx(1.1, rel=1e-12)
    straight = geometry.polyline([(0.0, 0.0), (200e-6, 0.0)], 2e-6, **SILICON)
    np.testing.assert_allclose([straight.xx, straight.yy], [beam.axial, beam.guided], rtol=1e-12)


@pytest.mark.parametrize("stress", [-2e6, 5e6])
def test_tension_of_a_guided_beam(stress):
    """Exact: K = N/(L − (2/λ) tanh(λL/2)), λ² = N/(E I); trigonometric in compression."""
    beam = geometry.Beam(length=200e-6, width=2e-6, stress=stress, **SILICON)
    pull = complex(stress * 2e-6 * THICK)
    root = np.sqrt(pull / complex(beam.bending))
    exact = (pull / (200e-6 - 2 / root * np.tanh(root * 100e-6))).real
    assert beam.guided == pytest.approx(exact, rel=2e-3)


@settings(max_examples=20)
@given(sizes, sizes)
def test_a_crab_leg_never_decouples(first, second):
    """9 E I/(La Lb (La + Lb)), and its mirror image alone takes it away."""
    width = 1e-9  # thin, so that nothing stretches
    leg = geometry.polyline([(0.0, 0.0), (first, 0.0), (first, second)], width, **SILICON)
    mirrored = geometry.polyline([(0.0, 0.0), (-first, 0.0), (-first, second)], width, **SILICON)
    coupling = float(geometry.crab_leg_coupling(YOUNG * THICK * width**3 / 12, first, second))
    assert coupling > 0.0
    assert leg.xy == pytest.approx(coupling, rel=1e-6, abs=0.0)
    assert leg.xy + mirrored.xy == pytest.approx(0.0, abs=1e-9 * coupling)


def test_the_coupling_of_a_u_fold_is_a_limit():
    """(1.14) within its 0.88 to 1.20 of the exact fold for a short connector, and far from it for a long one."""

    def ratio(shorter, connector):
        points = [(0.0, 0.0), (0.0, 200e-6), (connector, 200e-6), (connector, 200e-6 - shorter)]
        exact = geometry.polyline(points, 1e-9, **SILICON).xy
        bending = geometry.Beam(200e-6, 1e-9, **SILICON).bending
        return abs(geometry.u_fold_coupling(bending, 200e-6, shorter, connector) / exact)

    assert 0.88 < ratio(190e-6, 5e-6) < 1.20
    assert not 0.88 < ratio(190e-6, 200e-6) < 1.20
    assert geometry.u_fold_coupling(1.0, 2.0, 2.0, 1.0) == 0.0


def test_a_hairpin_is_its_polyline():
    found = geometry.hairpin(100e-6, 10e-6, 2, 2e-6, **SILICON)
    points = [(0, 0), (0, 100), (10, 100), (10, 0), (20, 0), (20, 100), (30, 100), (30, 0), (40, 0)]
    np.testing.assert_allclose(matrix(found), frame(1e-6 * np.array(points), 2e-6, **SILICON).real, rtol=1e-6)


AIR = {"pressure": 1e5, "viscosity": 1.82e-5}


def complex_stiffness(found, omega):
    return complex(found.stiffness, omega * found.damping)


@settings(max_examples=20)
@given(st.floats(50e-6, 500e-6), st.floats(50e-6, 500e-6), st.floats(1e-6, 5e-6), st.floats(1e3, 1e6))
def test_the_film_does_not_ask_which_side_is_the_length(length, width, gap, omega):
    """The closed sum runs along one side: along the other it is another series, with the same value."""
    one, other = (geometry.squeeze_film(*sides, gap, omega, **AIR) for sides in ((length, width), (width, length)))
    for a, b in zip(one, other, strict=True):
        assert a == pytest.approx(float(b), rel=1e-10)


@pytest.mark.parametrize(("length", "width", "gap", "omega"), [(200e-6, 100e-6, 2e-6, 2e4), (3e-4, 3e-4, 1.5e-6, 3e5)])
def test_the_film_is_blechs_series_and_reynolds_equation(length, width, gap, omega):
    found = complex_stiffness(geometry.squeeze_film(length, width, gap, omega, **AIR), omega)
    m = np.arange(1.0, 2001.0, 2.0)[:, None]
    n, c = m.T, width / length
    squeeze = 12 * 1.82e-5 * width**2 * omega / (1e5 * gap**2)
    inside = m**2 + (c * n) ** 2
    below = (m * n) ** 2 * (inside**2 + squeeze**2 / np.pi**4)
    damping = 64 * squeeze * 1e5 * length * width / (np.pi**6 * omega * gap) * np.sum(inside / below)
    stiffness = 64 * squeeze**2 * 1e5 * length * width / (np.pi**8 * gap) * np.sum(1.0 / below)
    assert found.imag / omega == pytest.approx(damping, rel=1e-7)
    assert found.real == pytest.approx(stiffness, rel=1e-7)
    coarse, fine = (film(length, width, gap, omega, 1e5, 1.82e-5, cells) for cells in (48, 96))
    assert found == pytest.approx((4 * fine - coarse) / 3, rel=2e-4)


def test_derivatives_of_the_film():
    """By the gap, against central differences of fourth order."""
    at = lambda gap: np.array(geometry.squeeze_film(3e-4, 1e-4, gap, 3e5, **AIR))  # noqa: E731
    slopes = jax.jacfwd(lambda gap: jnp.stack(geometry.squeeze_film(3e-4, 1e-4, gap, 3e5, **AIR)))(2e-6)
    h = 1e-9
    expected = (8 * (at(2e-6 + h) - at(2e-6 - h)) - (at(2e-6 + 2 * h) - at(2e-6 - 2 * h))) / (12 * h)
    np.testing.assert_allclose(slopes, expected, rtol=1e-9)


def test_gas_plates_and_combs():
    assert geometry.couette_damping(1e-6, 2e-6, 1.8e-5) == pytest.approx(9e-6, rel=1e-12)
    knudsen = 68e-9 * 101325 / 100.0 / 2e-6
    assert geometry.effective_viscosity(2e-6, 100.0, 1.0) == pytest.approx(1 / (1 + 9.638 * knudsen**1.159), rel=1e-12)
    plate = geometry.ParallelPlate(area=1e-8, gap=2e-6)
    energy = lambda gap: 0.5 * 8.8541878128e-12 * 1e-8 / gap * 25.0  # noqa: E731
    step = 1e-30
    assert plate.force(5.0) == pytest.approx(-energy(2e-6 + 1j * step).imag / step, rel=1e-12)
    closing = jax.grad(lambda gap: geometry.ParallelPlate(1e-8, gap).force(5.0))(2e-6)
    assert plate.stiffness(5.0) == pytest.approx(float(closing), rel=1e-9)
    comb = geometry.Comb(fingers=113, thickness=5e-6, gap=1e-6, overlap=50e-6, mismatch=0.1e-6)
    readout = mg.ChargeAmplifier.chi2010()
    assert comb.gradient == pytest.approx(float(readout.gradient[0]), rel=1e-12)
    assert comb.capacitance_mismatch == pytest.approx(float(2 * comb.gradient * 0.1e-6), rel=1e-12)
    phase = np.linspace(0, 2 * np.pi, 64, endpoint=False)
    force = np.asarray(comb.force(10.0 + 2.0 * np.cos(phase)))
    expected = geometry.drive_force(comb.gradient, 10.0, 2.0)
    harmonics = np.fft.rfft(force).real / 64 * np.array([1] + [2] * 32)
    np.testing.assert_allclose(harmonics[:3], np.array(expected), rtol=1e-12)
    with pytest.raises(InputError, match="gap"):
        geometry.ParallelPlate(area=1e-8, gap=-1e-6)


LAYOUT = geometry.PlateLayout(
    side=1.2e-3, thickness=50e-6, length_x=300e-6, length_y=250e-6, width=3e-6, gap=3e-6, pressure=100.0
)


def test_what_a_process_does():
    plain = LAYOUT.made(geometry.Process())
    thicker = LAYOUT.made(geometry.Process(thickness=5e-6))
    for name in ("kxx", "kyy", "mass"):
        assert getattr(thicker, name) / getattr(plain, name) == pytest.approx(1.1, rel=1e-12)
    etched = LAYOUT.made(geometry.Process(over_etch=0.1e-6))
    for name in ("kxx", "kyy"):
        assert getattr(etched, name) / getattr(plain, name) == pytest.approx((2.8 / 3.0) ** 3, rel=1e-12)
    turned = LAYOUT.made(geometry.Process(misalignment=0.01))
    assert turned.kxy == pytest.approx(float(0.5 * (plain.kxx - plain.kyy) * np.sin(0.02)), rel=1e-12)
    leaning = LAYOUT.made(geometry.Process(sidewall=0.005))
    heights = (np.arange(20_000) + 0.5) / 20_000
    widths = 3e-6 + 2 * 50e-6 * np.tan(0.005) * heights
    assert leaning.kxx / plain.kxx == pytest.approx(np.mean(widths**3) / 3e-6**3, rel=1e-7)
    warm = LAYOUT.made(geometry.Process(temperature=60.0))
    assert warm.kxx / plain.kxx == pytest.approx(1 - 60 * 6e-5, rel=1e-12)
    assert warm.dxx > plain.dxx
    lossy = eqx.tree_at(lambda made: made.loss, LAYOUT, 1.0 / 300.0).made(geometry.Process(misalignment=0.01))
    added = np.array([lossy.dxx - plain.dxx, lossy.dyy - plain.dyy, lossy.dxy])
    x, y = (np.sqrt(float(k * plain.mass)) / 300.0 for k in (plain.kxx, plain.kyy))
    turn = np.array([[np.cos(0.01), -np.sin(0.01)], [np.sin(0.01), np.cos(0.01)]])
    expected = turn @ np.diag([x, y]) @ turn.T
    assert added == pytest.approx([expected[0, 0], expected[1, 1], expected[0, 1]], rel=1e-9)
    with pytest.raises(InputError, match="side"):
        geometry.LayoutGyro(LAYOUT, geometry.Process(over_etch=1e-3))


def test_a_lot_varies_in_the_process_and_its_axes_together():
    device = geometry.LayoutGyro(LAYOUT)
    loop = mg.Operation.of(device.made).loop()
    loop = mg.ClosedLoop(device, loop.readout, loop.observer, loop.controller, loop.start)
    spread = mg.Spread((mg.Vary("device.process.over_etch", mg.Normal(std=0.1e-6)),))
    drawn = spread.draw(loop, mg.Scenario(), 0, np.arange(64))
    made = drawn.loop.device.made
    both = np.stack([made.kxx, made.kyy])
    assert np.corrcoef(both)[0, 1] > 0.999
    # 12 ∂K/K = −6 ∂a/a, each edge once
    assert np.std(np.log(both[0])) == pytest.approx(6 * 0.1 / 3.0, rel=0.1)
    slope = jax.grad(lambda etch: LAYOUT.numbers(geometry.Process(over_etch=etch))[1])(0.0)
    assert slope == pytest.approx(-6.0 / 3e-6 * float(device.made.kxx), rel=1e-9)


def shares(loop, device):
    """The loop of a layout whose read-out the same process makes."""
    readout = mg.LayoutReadout(mg.ChargeAmplifier.chi2010(0.0), device.process)
    return eqx.tree_at(lambda each: (each.device, each.readout), loop, (device, readout))


def test_the_readout_shares_the_process():
    """Against a sum over the height of the fingers, 5 µm high and 1 µm apart, which overlap by 50 µm."""
    device = geometry.LayoutGyro(LAYOUT)
    loop = shares(mg.Operation.of(device.made).loop(), device)
    laws = {"over_etch": 0.05e-6, "thickness": 0.2e-6, "sidewall": np.radians(0.5)}
    spread = mg.Spread(tuple(mg.Vary(f"process.{name}", mg.Normal(std=std)) for name, std in laws.items()))
    drawn = spread.draw(loop, mg.Scenario(), 0, np.arange(16)).loop
    height = (np.arange(4000) + 0.5) / 4000
    etch, thick, lean = (np.asarray(getattr(drawn.device.process, name)) for name in laws)
    gap = 1e-6 + 2 * etch - 2 * (5e-6 + thick) * np.tan(lean) * height[:, None]
    per_length = 113 * 8.8541878128e-12 * (5e-6 + thick) * np.mean(1.0 / gap, axis=0)
    made = drawn.readout.made
    np.testing.assert_allclose(made.gradient[1], per_length, rtol=1e-6)
    np.testing.assert_allclose(drawn.readout.scale[0], -2.0 * 10.0 / 1e-12 * per_length, rtol=1e-6)
    np.testing.assert_allclose(made.gradient[0] * made.overlap[0], per_length * (50e-6 - 2 * etch), rtol=1e-6)
    narrow = spread.items[:1]
    drawn = mg.Spread(narrow).draw(loop, mg.Scenario(), 0, np.arange(16)).loop
    assert np.corrcoef(drawn.device.made.kxx, drawn.readout.scale[0])[0, 1] < -0.99  # of a scale below zero
    none, sharp = loop.readout, mg.LayoutReadout(loop.readout.drawn, geometry.Process(sidewall=0.0))
    assert stated_at(Root(loop, mg.Scenario()), "process.over_etch") == "m"
    assert none.scale == sharp.scale == pytest.approx(np.array(loop.readout.drawn.scale), rel=1e-14)
    slope = jax.grad(lambda a: mg.LayoutReadout(none.drawn, geometry.Process(sidewall=a)).scale[0])(0.0)
    assert slope == pytest.approx(5.0 * float(none.scale[0]), rel=1e-9)
    with pytest.raises(InputError, match="gap"):
        mg.LayoutReadout(none.drawn, geometry.Process(over_etch=-0.6e-6))


@pytest.mark.slow
def test_loop_sweep_and_tornado_take_a_layout():
    """It runs as the device that is made, and a lot and a tornado of it speak of the process."""
    device = geometry.LayoutGyro(LAYOUT)
    made = mg.Operation.of(device.made)
    plain = made.loop()
    loop = eqx.tree_at(lambda each: each.device, plain, device)
    run = {"sample_rate": made.sample_rate, "duration": 500 / made.sample_rate}
    one, other = (mg.simulate(each, 1.0, **run) for each in (loop, plain))
    np.testing.assert_allclose(one.motion, other.motion, rtol=1e-9, atol=1e-18)
    spread = mg.Spread(
        (
            mg.Vary("device.process.over_etch", mg.Normal(std=0.05e-6)),
            mg.Vary("device.process.misalignment", mg.Normal(std=1e-3)),
        )
    )
    lot = mg.sweep(loop, spread, 1.0, dies=8, **run)
    assert np.all(np.isfinite(lot.data["rate_error_end"]))
    spread = mg.Spread((*spread.items, mg.Vary("device.process.thickness", mg.Normal(std=0.1 * 50e-6))))
    stiffness = mg.Output("kxx", "N/m", lambda loop: loop.device.made.kxx, of_loop=True)
    found = mg.tornado(loop, spread, 1.0, of=(stiffness,), repeats=2, **run)
    assert found.high[0, 2] == pytest.approx(0.1 * float(device.made.kxx), rel=2e-4)  # a tenth thicker, thesis 1.2
    assert "device.process.thickness" in str(found)
    both = mg.Spread((mg.Vary("process.over_etch", mg.Normal(std=0.02e-6)),))
    lot = mg.sweep(shares(loop, device), both, 1.0, dies=8, **run)
    assert np.all(np.isfinite(lot.data["rate_error_end"]))
    assert "process.over_etch" in str(mg.tornado(shares(loop, device), both, 1.0, **run))


def test_a_layout_is_centred_by_gradient_for_yield():
    """Both modes within 8 % of the drawing's while the process etches 0.15 ± 0.05 µm too much: legs that are drawn
    wider by what is lost hold that, the plate's loss and all; found by gradient of the yield's smooth form.
    """
    drawn, rng = LAYOUT, np.random.default_rng(0)
    lots = geometry.Process(
        over_etch=1e-7 * rng.normal(1.5, 0.5, 400), thickness=1e-7 * rng.standard_normal(400),
        sidewall=np.radians(0.2) * rng.standard_normal(400),
    )  # fmt: skip

    def modes(width, process):
        mass, kxx, kyy, *_ = eqx.tree_at(lambda made: made.width, drawn, width).numbers(process)
        return jnp.sqrt(jnp.stack([kxx / mass, kyy / mass]))

    wanted = modes(drawn.width, geometry.Process())

    @jax.jit
    def off(width):
        return jnp.max(jnp.abs(modes(width, lots) / wanted[:, None] - 1.0), axis=0) / 0.08

    def missed(scale):  # how many dies miss, a step made as smooth as a tenth of the tolerance
        return jnp.mean(jax.nn.sigmoid((off(scale * drawn.width) - 1.0) / 0.1))

    slope = jax.jit(jax.value_and_grad(missed))
    assert float(slope(1.05)[1]) == pytest.approx(float(missed(1.05 + 1e-6) - missed(1.05 - 1e-6)) / 2e-6, rel=1e-4)
    found = optimize.minimize(lambda s: tuple(map(np.asarray, slope(s[0]))), [1.04], jac=True, bounds=[(0.9, 1.4)]).x[0]
    before, after = (float(np.mean(off(scale * drawn.width) <= 1.0)) for scale in (1.0, found))
    best = max(float(np.mean(off(scale * drawn.width) <= 1.0)) for scale in np.linspace(0.95, 1.4, 91))
    assert after >= best - 0.02
    assert after > before + 0.2
    assert found == pytest.approx(1.0 + 2.0 * 1.5e-7 / float(drawn.width), rel=0.02)
