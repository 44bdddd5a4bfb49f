"""Laws that no catalogue holds, drawn from sweeps whose rows obey closed describing functions."""

import json
import re
from dataclasses import dataclass, replace
from pathlib import Path

import browser
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from bench_case import ONE_AXIS, RESONATOR, bench
from lab.die import Hidden
from lab.faults import Faults

from memsgyro_jax.app.cli import main
from memsgyro_jax.base.errors import InputError
from memsgyro_jax.diagnosis.backbone import Equations, backbone, describing
from memsgyro_jax.diagnosis.drift_in_time import with_drift_alone
from memsgyro_jax.diagnosis.fit import fit_case
from memsgyro_jax.diagnosis.law import _grown as grown
from memsgyro_jax.diagnosis.law import _Trial, draw_law
from memsgyro_jax.diagnosis.law_file import LawTerm, bends, law_text
from memsgyro_jax.diagnosis.law_fit import beside_known, fit_law, of_the_catalogue
from memsgyro_jax.diagnosis.leak import leak_past
from memsgyro_jax.diagnosis.result import validation_error
from memsgyro_jax.effects import by_name, catalogue, load_effects
from memsgyro_jax.effects.trial import moments
from memsgyro_jax.measurement.case import load_case


CASE = """
schema = "memsgyro-case/1"
name = "stranger"
device = "resonator"
[design]
resonance = {{ value = {hertz}, unit = "Hz", tolerance = 0.05 }}
quality_factor = {{ value = {quality}, unit = "1", tolerance = 0.5 }}
static_gain = {{ value = 1, unit = "1", tolerance = 0.9 }}
[readout]
quantity = "{quantity}"
scale = {{ value = 1, unit = "{scale}" }}
[[experiment]]
name = "sweep"
kind = "frequency_sweep"
file = "sweep.csv"
settled = {settled}
noise_std = {{ value = {noise}, unit = "V" }}
"""
BACKGROUND = (0.02 - 0.05j) * 0.8  # V, in units of the displacement
TOP = 0.8  # V, about the largest amplitude
ROWS = 60  # of each sweep


@dataclass(frozen=True)
class Device:
    """Frequency [Hz] and quality factor."""

    hertz: float
    quality: float

    @property
    def omega(self):
        return 2 * np.pi * self.hertz

    @property
    def width(self):
        return self.omega / self.quality


def bowed(a, device):
    """F = −s·x·|x|, which takes 0.8 widths off the resonance at the top."""
    return -1.6 * device.width * device.omega * a / TOP, 0 * a


def contact(a, device):
    """A spring that is touched at 0.3 V: F = −s·(|x| − 0.3)·sign(x) beyond."""
    ratio = np.minimum(0.3 / a, 1.0)
    share = 1 - 2 / np.pi * (np.arcsin(ratio) + ratio * np.sqrt(1 - ratio**2))
    return 2.5 * device.width * device.omega * share, 0 * a


def dragged(a, device):
    """F = −s·v·|v|, which doubles the damping at the top."""
    return 0 * a, device.width * a / TOP


LAWS = {"bowed": bowed, "contact": contact, "dragged": dragged}
DEVICES = {"wire": Device(1650.0, 150.0), "fork": Device(32768.0, 20000.0)}


def swept(folder, law, device, seed=0, *, raw=False, warmed=0.0, leak=0.0):
    """Two sweeps over frequency, each row where its amplitude is one of a grid, below and above resonance; `raw` as a
    lock-in writes them: velocities beside a background, with a clock, from a row on that began nobody knows how. With
    `warmed` [1/K] the stiffness follows a temperature of 20 °C below and 30 °C above resonance; `leak` of the drive is
    read beside the motion.
    """
    rng, rows, warm = np.random.default_rng(seed), [], []
    linear = device.width * device.omega
    for drive in (0.3 if warmed else 0.45, 1.1):  # the lower one, with a drift beside it, does not reach the spring
        force = drive * TOP * linear
        a = np.geomspace(0.03 * TOP, 6 * TOP, 4000)
        stiffness, damping = law(a, device)
        linear_k, d = device.omega**2 + stiffness, device.width + damping
        # |(K − ω²) + iωD| = F/a, solved for ω² on both sides
        for side in (-1, 1):
            k = linear_k + 5.0 * side * warmed * device.omega**2
            half, rest = k - d**2 / 2, (force / a) ** 2 - d**2 * (k - d**2 / 4)
            real = rest > 0
            square = half[real] + side * np.sqrt(rest[real])
            omega = np.sqrt(square)
            x = force / (k[real] - square + 1j * omega * d[real])
            order = np.argsort(omega)
            grid = np.geomspace(0.05, 6.0, ROWS // 2)[::-side]
            wanted = device.omega + side * device.width * grid
            inside = (wanted > omega.min()) & (wanted < omega.max())
            at = lambda part, w=wanted[inside], o=omega[order], p=order: np.interp(w, o, part[p])  # noqa: E731
            rows += [(drive * TOP, w, p, q) for w, p, q in zip(wanted[inside], at(x.real), at(x.imag), strict=True)]
            warm += [25.0 + 5.0 * side] * int(inside.sum())
    order = sorted(range(len(rows)), key=rows.__getitem__)
    table, warm = np.array(rows)[order], np.array(warm)[order]
    unit = device.omega if raw else 1.0
    noise = 1e-3 * TOP * unit
    if raw:
        turned = 1j * table[:, 1] * (table[:, 2] + 1j * table[:, 3]) + unit * BACKGROUND
        table[:, 2:] = np.stack([turned.real, turned.imag], axis=1)
    table[:, 2:] += table[:, :1] * [np.real(leak), np.imag(leak)]
    table[:, 2:] += noise * rng.standard_normal(table[:, 2:].shape)
    table[:, 1] /= 2 * np.pi
    table = np.column_stack([table, 60.0 * np.arange(len(table))])
    header = f"F [V],f [Hz],y_I [V],y_Q [V],{'t' if raw else 'clock'} [s]"
    if warmed:
        table, header = np.column_stack([table, warm]), f"{header},T [degC]"
    np.savetxt(folder / "sweep.csv", table, fmt="%.12g", delimiter=",", header=header, comments="")
    text = CASE.format(
        hertz=device.hertz, quality=device.quality, noise=noise, settled="false" if raw else "true",
        quantity="velocity" if raw else "displacement", scale="V*s/V" if raw else "V/V",
    )  # fmt: skip
    (folder / "case.toml").write_text(text)
    return load_case(folder)


@pytest.mark.slow  # `test_the_command_draws_writes_and_fits` draws one of them too
@pytest.mark.parametrize("device", DEVICES)
@pytest.mark.parametrize("name", LAWS)
def test_a_law_is_drawn_written_and_helps_where_it_was_not_fitted(name, device, tmp_path):
    law, of = LAWS[name], DEVICES[device]
    before = fit_case(swept(tmp_path, law, of))
    curve, drawn = backbone(before), draw_law(before)
    inner = slice(10, -3)
    stiffness, damping = law(curve.amplitude[inner], of)
    found = curve.omega[inner] ** 2 - of.omega**2 - stiffness
    assert np.all(np.abs(found) < 6 * 2 * of.omega * curve.omega_std[inner] + 0.1 * of.width * of.omega)
    assert np.all(np.abs(curve.damping[inner] - of.width - damping) < 6 * curve.damping_std[inner] + 0.1 * of.width)
    assert 1 <= len(drawn.terms) <= 3
    assert drawn.left[0] > 2.0
    assert drawn.left[1] < 1.3
    after = fit_law(drawn, drawn.write(tmp_path / "law.py"))
    assert validation_error(before) > 4.0
    # The rows obey the first harmonic alone, the model its overtones too, which a corner has.
    assert validation_error(after) < (2.0 if name == "contact" else 1.2)
    if name == "contact":
        stop = after.model.effects[-1]
        assert [float(stop.threshold), float(stop.exponent)] == pytest.approx([0.3, 0.0], abs=0.02)


def test_a_law_is_drawn_beside_what_is_known_to_be_there(tmp_path):
    """A spring that is touched while the resonance drifts by 0.4 widths, which took the place of the law."""
    device = DEVICES["wire"]
    drift = 0.08 / device.quality  # of the stiffness, per kelvin
    case = swept(tmp_path, contact, device, warmed=drift)
    fit = beside_known(case, [by_name("thermal_drift", "stiffness", among=catalogue(1))])
    found = next(e for e in fit.estimates if e.name == "thermal_drift stiffness")
    assert found.value == pytest.approx(drift, abs=max(5.0 * found.std, 0.02 * drift))
    law = draw_law(fit)
    assert [t.kind for t in law.terms] == ["stiffness"]
    assert law.terms[0].threshold == pytest.approx(0.3, abs=0.02)
    assert law.left[1] < 1.3


def test_what_leaks_past_the_device_is_drawn_as_no_law(tmp_path):
    """As through the capacitance of a crystal: two terms were drawn, springs that cancel, and nothing was explained."""
    leak = 0.06 + 0.08j
    fit = beside_known(swept(tmp_path, dragged, DEVICES["wire"], leak=leak), ())
    (term,) = leak_past(fit, 0)
    beside = beside_known(fit.case, (term,))
    assert leak_past(beside, 0) == ()
    law = draw_law(beside)
    after = fit_law(law, law.write(tmp_path / "law.py"))
    found = {effect.name: effect for effect in after.model.effects}
    assert complex(*np.asarray(found[term.name].strength)) == pytest.approx(leak, abs=1e-3)
    assert law.names == ("drawn_damping",)
    assert float(found["drawn_damping"].exponent) == pytest.approx(1.0, abs=0.05)
    assert of_the_catalogue(law, after) == {"drawn_damping": "quadratic_damping x"}  # which `fit --add` takes


@pytest.mark.parametrize("name", LAWS)
def test_a_law_is_no_leak(name, tmp_path):
    assert leak_past(beside_known(swept(tmp_path, LAWS[name], DEVICES["wire"]), ()), 0) == ()


@pytest.mark.parametrize(
    ("term", "exponent", "name"),
    [
        (("stiffness", 1.0, 2.0, None), 2.02, "cubic_stiffness"),
        (("stiffness", 1.0, 2.0, None), 2.2, ""),
        (("stiffness", 1.0, 2.0, 1e-7), 2.0, ""),  # from a threshold on it is another law
        (("damping", 1.0, -0.9, None), -0.95, "dry_friction"),
        (("damping", 1.0, 2.0, None), 2.0, ""),
        (("even_stiffness", 1.0, 1.0, None), 1.0, "quadratic_stiffness"),
        (("stiffness", 1.0, 2.0, None), float("nan"), ""),  # edited away
    ],
)
def test_a_law_of_the_catalogue_is_known_by_its_exponent(term, exponent, name):
    assert LawTerm(*term, 2e-6, 1e-9).known_as(exponent) == name


def test_terms_that_cancel_are_no_law():
    """Two alike of opposite sign are the logarithm between them."""
    a = np.geomspace(0.01, 1.0, 80)
    terms = tuple(LawTerm("damping", 1.0, exponent, None, 1.0, 0.01) for exponent in (0.93, 0.92))
    shares = np.stack([describing(term.share, a) for term in terms], axis=1)
    unit, flat = np.eye(2), np.zeros((80, 2, 0))
    for mixed, cancels in (((100.0, -100.0), True), ((1.0, 1.0), False), ((1.0, -0.5), False)):
        target = -np.outer(shares @ mixed, unit[1])
        given = Equations(a, np.ones(80), *(np.tile(-one, (80, 1)) for one in unit), flat, target, a, np.ones(80))
        trial = _Trial(given, {"stiffness": a, "damping": a}, np.ones(160), terms, -1.0)
        assert np.isinf(trial.left) == cancels


@pytest.mark.slow
def test_the_lowest_drives_name_what_a_law_is_drawn_beside(tmp_path, capsys):
    """No effect explains a drift and a spring that is touched; of the lowest drive alone the drift is found."""
    drift = 0.08 / DEVICES["wire"].quality
    swept(tmp_path, contact, DEVICES["wire"], warmed=drift)
    with pytest.raises(SystemExit, match="0"):
        main(["diagnose", str(tmp_path)])
    said = capsys.readouterr().out
    assert said.startswith("stranger: unknown effect")
    (command,) = [line.split(": ")[1] for line in said.splitlines() if "--drives" in line]
    assert command == f"memsgyro diagnose {tmp_path} --drives 1"
    with pytest.raises(SystemExit, match="0"):
        main([*command.split()[1:], "--json", str(tmp_path / "found.json")])
    said = capsys.readouterr().out
    assert said.startswith("stranger: found")
    assert said.splitlines()[-1].endswith(f'memsgyro law {tmp_path} --out my_law.py --add "thermal_drift stiffness"')
    (effect,) = json.loads((tmp_path / "found.json").read_text())["effects"]
    assert effect["estimate"] == pytest.approx(drift, rel=0.03)


@pytest.mark.slow
def test_a_law_of_several_records_stands_beside_their_phase_and_the_levels_of_their_drive(tmp_path):
    """All records turned alike, and drive levels 3 % off: each is one number, and the law is what it is without."""
    faults = Faults(phase=-0.3, levels=(0.03, -0.03, 0.0))
    spring = Hidden(cubic_stiffness_x=3.9 * RESONATOR.kxx)
    case = bench(spring, 0, replace(ONE_AXIS, faults=faults), RESONATOR).case
    law = draw_law(fit_case(case))
    after = fit_law(law, law.write(tmp_path / "law.py"))
    found = {e.name: np.asarray(e.strength) for e in after.model.effects}
    labels = sorted(e.label for e in after.model.effects if e.of_instrument)
    assert labels == ["drive_level", "lock_in_background", "reference_phase"]
    assert found["reference_phase"] == pytest.approx(-0.3, abs=0.01)
    assert found["drive_level"][:2] == pytest.approx([0.97 / 1.03 - 1, 1 / 1.03 - 1], abs=0.01)
    assert float(after.model.effects[-1].exponent) == pytest.approx(2.0, abs=0.1)
    assert after.chi2_per_dof < 1.7  # that of the case without a fault is 1.49


SEEN = ((1e-9, 2e-6), (1e-3, 0.2))
TERMS = (
    LawTerm("stiffness", -3.0, 1.3, None, 2e-6, 1e-9),
    LawTerm("stiffness", 40.0, 0.5, 4e-7, 2e-6, 1e-9),
    LawTerm("damping", 2e-6, -0.6, None, 0.2, 1e-3),
    LawTerm("even_stiffness", 20.0, 1.4, None, 2e-6, 1e-9),
)


def test_the_file_holds_what_was_drawn(tmp_path):
    """Every effect in it is the term it was written from; a strange name of a case stays a comment."""
    names = ("drawn_stiffness", "drawn_stiffness_2", "drawn_damping", "drawn_even_stiffness")
    text = law_text('a "strange" """case\\', 1, names, SEEN, TERMS, ())
    (tmp_path / "law.py").write_text(text)
    effects = load_effects(tmp_path / "law.py", as_written=True)
    assert [e.name for e in effects] == list(names)
    assert "stand" not in text
    units = "lengths are in V and forces in V, as the records are: m stands for V, N for V"
    assert f"Here {units}." in law_text("case", 1, names, SEEN, TERMS, (), "V", units).split('"""')[1]
    now = moments(effects[0], 2)
    for effect, term in zip(effects, TERMS, strict=True):
        z = np.asarray(now.velocity if term.kind == "damping" else now.displacement)[:, 1]
        z = np.abs(z) if term.kind == "even_stiffness" else z
        force = jax.vmap(effect.force)(now)
        np.testing.assert_allclose(force[:, 1], -term.strength * z * term.share(z), rtol=1e-5, atol=1e-25)
        assert not np.any(force[:, 0])
    assert not any(np.any(e.strength) for e in load_effects(tmp_path / "law.py")), "a search starts at zero"


def test_a_device_at_rest_is_damped():
    """Of a damping that rises with the speed to the power 0.2 from nothing, no term is drawn beside a linear part that
    would feed the motion.
    """
    omega, a = np.full(80, 1e4), np.geomspace(1e-2, 1.0, 80)
    shown = np.stack([np.zeros(80), 5.0 * describing(lambda z: np.abs(z) ** 0.2, a) - 4.0], axis=1)
    shown += 0.02 * np.random.default_rng(0).standard_normal((80, 2))
    one = np.ones((80, 1)) * np.eye(2)[:, None] / 0.02
    given = Equations(a, omega, one[0], one[1], np.zeros((80, 2, 0)), shown / 0.02, np.full(80, "decay"), np.zeros(80))
    trial = grown(_Trial(given, {"stiffness": a, "damping": a}, np.ones(160), (), -3.9), 2)
    assert trial.left < 1.2
    assert trial.found[1 + sum(term.kind == "stiffness" for term in trial.terms)] >= -3.9


def test_a_spline_is_written_too(tmp_path):
    knots, values = np.array([1e-7, 5e-7, 2e-6]), np.array([0.3, -2.0])
    (tmp_path / "law.py").write_text(law_text("case", 0, ("drawn_stiffness",), SEEN, (), ((knots, values),)))
    (effect,) = load_effects(tmp_path / "law.py", 1, as_written=True)
    z = np.linspace(-2e-6, 2e-6, 9)
    now = jax.vmap(lambda q: eqx.tree_at(lambda m: m.displacement, moments_one(), q[None]))(jnp.asarray(z))
    share = sum(v * bend(z) for v, bend in zip(values, bends(knots), strict=True))
    np.testing.assert_allclose(jax.vmap(effect.force)(now)[:, 0], -share * z, rtol=1e-5, atol=1e-25)


def moments_one():
    """One instant of a device of one axis."""
    return jax.tree.map(lambda leaf: leaf[0], moments(by_name("cubic_stiffness", among=catalogue(1)), 1))


@pytest.mark.slow
def test_the_command_draws_writes_and_fits(tmp_path, capsys):
    swept(tmp_path, bowed, DEVICES["fork"], raw=True)
    law, page = tmp_path / "law.py", tmp_path / "page.html"
    with pytest.raises(SystemExit) as ended:
        main(["law", str(tmp_path), "--out", str(law), "--terms", "1", "--report", str(page)])
    assert ended.value.code == 0
    out = capsys.readouterr().out
    assert "drawn_stiffness" in out
    assert all(text in out for text in ("amplitude [V]", " 1/V²", " V/s; beyond")), "in what the record is in"
    assert f"memsgyro law {tmp_path} --edited {law}" in out
    assert "Frequency and damping against amplitude" in page.read_text()
    assert load_effects(law, 1)
    browser.check(tmp_path, {"looked_at": page.read_text()})
    with pytest.raises(SystemExit) as ended:
        main(["law", str(tmp_path), "--out", str(law), "--edited", str(law)])
    assert (ended.value.code, "Either option `--out`" in capsys.readouterr().err) == (2, True)
    before, after = re.search(r"^sweep +validation +(\S+) +(\S+)", out, re.MULTILINE).groups()
    assert float(before) > 4.0
    assert float(after) < 1.3


@pytest.mark.slow
def test_a_waveform_tells_the_even_part_too(tmp_path, capsys):
    """Of the cantilever: with the odd parts alone, the later half is left at 1.14 × its noise."""
    case, law = Path(__file__).parents[1] / "data" / "cantilever", tmp_path / "law.py"
    for option in (["--out", str(law)], ["--edited", str(law)]):
        with pytest.raises(SystemExit) as ended:
            main(["law", str(case), *option])
        assert ended.value.code == 0
        out = capsys.readouterr().out
        assert float(re.search(r"^decay +validation +\S+ +(\S+)", out, re.MULTILINE)[1]) < 1.05
    assert [e.name for e in load_effects(law, 1)] == ["drawn_stiffness", "drawn_damping", "drawn_even_stiffness"]


def test_without_rows_of_an_axis_there_is_no_backbone(tmp_path):
    before = fit_case(swept(tmp_path, bowed, DEVICES["fork"]))
    with pytest.raises(InputError, match="sweeps or decays of axis y"):
        backbone(before, 1)
    with pytest.raises(InputError, match="`fit` must be what `fit` returned, but is of type Case"):
        backbone(before.case)
    assert with_drift_alone(before) is None, "of driven records drifts are terms of the instrument"
