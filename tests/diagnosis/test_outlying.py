"""Rows that stand alone are named and left out; a misfit, however large, names nobody."""

from dataclasses import replace
from types import SimpleNamespace

import equinox as eqx
import numpy as np
import pytest
from bench_case import RESONATOR
from lab.die import Hidden
from long_sweep import case_of

from memsgyro_jax.app.report.fit_text import fit_entries, fit_text
from memsgyro_jax.diagnosis import misfit
from memsgyro_jax.diagnosis.compare import beside_outlying, compare, judged
from memsgyro_jax.diagnosis.drives import without_rows
from memsgyro_jax.diagnosis.fit import beside_case, fit_case
from memsgyro_jax.diagnosis.instrument import instrument_terms
from memsgyro_jax.diagnosis.joint_residual import Joint
from memsgyro_jax.diagnosis.optimum import optimise
from memsgyro_jax.diagnosis.outlying import (
    _to_leave_out,
    far_off,
    fit_without,
    not_pulled,
    of_rows,
    outlying,
    search_beside_outlying,
)
from memsgyro_jax.effects import by_name, catalogue
from memsgyro_jax.measurement.case import load_case
from memsgyro_jax.measurement.import_case import import_case
from memsgyro_jax.measurement.linear_start import starting_device
from memsgyro_jax.measurement.readings import model_of, readings_of


WRONG = (11, 40, 77, 130, 151)


@pytest.mark.parametrize("seed", range(3))
def test_wrong_rows_are_named_and_leave_the_fit_what_it_was(seed):
    clean, fit = fit_case(case_of(seed)), fit_case(case_of(seed, rows=WRONG))
    found = outlying(fit)
    assert found == {0: WRONG}
    joint = Joint(fit.model, without_rows(fit.joint.readings, found))
    again = beside_case(fit.case, joint, optimise(joint, joint.start, joint.base(), joint.fitted))
    assert fit.chi2_per_dof > 1.5
    assert again.chi2_per_dof < 1.2
    assert sum(e.count for e in again.errors) == sum(e.count for e in clean.errors) - 2 * len(WRONG)
    free = again.optimum.free
    moved = np.abs(again.optimum.vector[free] - clean.optimum.vector[free]) / clean.optimum.std
    assert np.all(moved < 1.0)


def test_a_comparison_leaves_out_what_stands_alone_and_names_it():
    """As the diagnosis does whose model is compared, else that model would fail by the very rows it left out."""
    model = fit_case(case_of(1)).model
    case = case_of(1, rows=(44,), sigmas=40.0)
    result = compare(model, case, fitted=False)
    assert result.explained
    assert result.left_out == {0: (44,)}
    assert "but for row 45 (near " in result.verdict
    assert result.to_dict()["outlying"] == {"sweep": [44]}
    part = compare(model, case_of(1, rows=range(5, 175, 12), sigmas=40.0), fitted=False)
    assert not part.explained
    assert part.left_out == {}


def test_rows_are_left_out_also_where_finer_tests_fail_of_what_has_the_size_of_the_noise(monkeypatch):
    """A diagnosis, which rests on the size, left the row out; the comparison counted it, 63 times the noise."""
    model, case = fit_case(case_of(1)).model, case_of(1, rows=(44,), sigmas=40.0)
    tests = misfit.check_all
    failing = lambda *given: (*(made := tests(*given))[:-1], replace(made[-1], p_value=0.0))  # noqa: E731
    monkeypatch.setattr("memsgyro_jax.diagnosis.compare.check_all", failing)
    result = compare(model, case, fitted=False)
    assert not result.explained
    assert result.left_out == {0: (44,)}
    assert "not even without row 45 (near " in result.verdict
    assert "which is outlying and left out: " in result.verdict


def test_a_fit_leaves_out_and_names_the_same_rows():
    """`memsgyro fit` printed one row as 33 times the noise of a whole record, and did not say which."""
    case = case_of(1, rows=(44,), sigmas=40.0)
    fit = fit_case(case)
    found = beside_outlying(judged(fit), lambda rows: fit_without(fit, rows))
    assert found.left_out == {0: (44,)}
    whole = compare(None, case)
    np.testing.assert_allclose(found.fit.optimum.vector, whole.fit.optimum.vector, rtol=1e-6, atol=1e-12)
    assert "but for row 45 (near " in fit_text(fit, found)
    assert "which is outlying" in found.verdict
    assert "which are outlying" in replace(found, left_out={0: (44, 90)}).verdict
    assert fit_entries(fit, found)["outlying"] == {"sweep": [44]}
    assert fit_entries(fit, found)["explained"]
    part = fit_case(case_of(1, Hidden(cubic_stiffness_x=3.9 * RESONATOR.kxx), rows=(44,), sigmas=4000.0))
    kept = beside_outlying(judged(part), lambda rows: fit_without(part, rows))
    assert kept.left_out == {}, "a law is missing"


def test_rows_far_off_in_what_was_read_are_named_of_a_case_that_nothing_explains():
    said = far_off(case_of(1, rows=(44,), sigmas=3000.0))
    assert said.startswith(
        " Rows that lie far off their neighbours pull every fit, to be corrected or left out: row 45 ("
    )
    assert far_off(case_of(1)) == ""


def test_a_row_of_a_fall_is_told():
    size = np.array([0.1, 0.2, 0.4, 0.6, 0.8, 0.5, 0.15, 0.14, 0.13, 0.12])
    record = SimpleNamespace(readings=size[:, None] * 1j, rows=10, name="up", at=lambda row: "near 1 Hz")
    case = SimpleNamespace(records=[record])
    assert of_rows(case, {0: (5,)}) == "row 6 (near 1 Hz, read while the response fell from branch to branch) of up"
    assert of_rows(case, {0: (2,)}) == "row 3 (near 1 Hz) of up"
    size[3] = 0.05  # a row that stands alone comes back
    assert of_rows(case, {0: (3,)}) == "row 4 (near 1 Hz) of up"


@pytest.mark.slow
def test_normal_noise_and_a_missing_law_name_nobody(monkeypatch):
    """One false row in a thousand records, and none where a spring leaves several times the noise."""
    assert all(outlying(fit_case(case_of(seed))) == {} for seed in range(8))
    missing = fit_case(case_of(0, Hidden(cubic_stiffness_x=3.9 * RESONATOR.kxx)))
    assert missing.chi2_per_dof > 20.0
    assert outlying(missing) == {}
    # Had some been named: no fit without them is made, as they leave the law that is missing.
    monkeypatch.setattr("memsgyro_jax.diagnosis.outlying.outlying", lambda fit: {0: WRONG})
    assert _to_leave_out(missing) == {}


def test_a_row_that_pulls_the_fit_away_from_all_others_is_named():
    """The row of a fall from one branch of a bent resonance to another may be thousands of standard deviations off."""
    fit = fit_case(case_of(1, rows=(44,), sigmas=3000.0))
    rest = np.concatenate([d.white[:, 0].ravel() for _, d in fit.deviations])
    assert np.nanmedian(np.abs(rest)) > 3.0, "so that the row hides behind its neighbours"
    assert _to_leave_out(fit) == {0: (44,)}
    missing = fit_case(case_of(0, Hidden(cubic_stiffness_x=3.9 * RESONATOR.kxx)))
    assert not_pulled(missing) is None


@pytest.mark.slow
def test_a_row_is_named_beside_what_is_known_of_the_instrument():
    case = case_of(1, rows=(44,), sigmas=3000.0)
    fit = fit_case(case, [term for term in instrument_terms(case) if term.prior])
    assert _to_leave_out(fit) == {0: (44,)}


def test_a_record_of_which_a_part_is_wrong_keeps_all_rows():
    assert outlying(fit_case(case_of(0, rows=range(5, 175, 12), sigmas=40.0))) == {}


@pytest.mark.parametrize(
    ("base", "fewer", "final", "again", "named"),
    [
        (True, True, True, True, False),  # nothing is missing
        (False, True, True, True, True),  # all that was missing were these rows
        (False, False, True, True, False),  # they belonged to what an effect explains
        (False, False, False, True, True),  # they stand out beside an effect
        (False, False, False, False, False),  # nothing explains the case: they may be what is unknown
    ],
)
def test_rows_are_left_out_where_the_rest_is_explained(monkeypatch, base, fewer, final, again, named):
    monkeypatch.setattr("memsgyro_jax.diagnosis.outlying._to_leave_out", lambda fit: {0: (3,)})

    monkeypatch.setattr("memsgyro_jax.diagnosis.outlying.near_rows", lambda fit, readings, rows: {})

    def state(done):
        joint = SimpleNamespace(readings=())
        return SimpleNamespace(done=done, base=None, steps=[SimpleNamespace(fit=None)], joint=joint)

    def searched(search):
        yield state(again if search is without else final), None, "", None

    whole, without = state(base), state(fewer)
    found, rows = search_beside_outlying(lambda rows: without if rows else whole, searched, lambda one: one.done)
    assert rows == ({0: (3,)} if named else {})
    assert found[0].done == (again if named else final)


FALL = """
schema = "memsgyro-case/1"
name = "fall"
device = "resonator"
[[experiment]]
name = "up"
kind = "frequency_sweep"
file = "up.csv"
settled = true
noise_std = { value = 2e-5, unit = "V" }
"""


def fell(folder):
    """Sweeps up at three drives of a spring that hardens, k·q + s·q³ with its third harmonic; the last falls from its
    branch, and the row there is read while it does.
    """
    f, noise, quality = np.linspace(4988.0, 5040.0, 121), np.random.default_rng(0), 1000.0
    w0, table = 2 * np.pi * 5000.0, []
    gain, cubic = 5.0 / quality * w0**2, 32.0 / 3.0 / quality * w0**2
    for drive in (0.02, 0.06, 0.2):
        seen, at, fallen = [], None, 0
        for k, w in enumerate(2 * np.pi * f):
            # Stiffness over the squared amplitude, to the first order in the third harmonic.
            bent = np.poly1d([3 / 128 * (cubic / w0) ** 2, 0.75 * cubic, w0**2 - w**2])
            roots = ((bent * bent + (w * w0 / quality) ** 2) * np.poly1d([1, 0]) - (gain * drive) ** 2).roots
            real = roots[np.abs(roots.imag) < 1e-9 * np.abs(roots)].real
            near = real[real < 3 * (gain * drive * quality / w0**2) ** 2]
            last, at = at, near.min() if at is None else near[np.argmin(np.abs(np.sqrt(near) - np.sqrt(at)))]
            fallen = k if last and at < 0.1 * last else fallen
            seen.append(gain * drive / (bent(at) + 1j * w * w0 / quality))
        if fallen:
            seen[fallen] = 0.35 * seen[fallen - 1] + 0.65 * seen[fallen]
        table.append(np.column_stack([np.full(f.size, drive), f, np.real(seen), np.imag(seen)]))
    rows = np.concatenate(table)
    rows[:, 2:] += 2e-5 * noise.standard_normal((len(rows), 2))
    header = "drive [V],f [Hz],X [V],Y [V]"
    np.savetxt(folder / "up.csv", rows, fmt="%.9g", delimiter=",", header=header, comments="")
    (folder / "case.toml").write_text(FALL)
    return load_case(folder), 2 * f.size + fallen


def test_a_row_read_while_the_response_fell_is_left_out_of_a_fit_of_effects(tmp_path):
    """It pulled the fit to 841 000 times the noise variance, where a diagnosis leaves it out."""
    case, row = fell(tmp_path)
    fit = fit_case(case, [by_name("cubic_stiffness", "x", among=catalogue(1))])
    assert fit.chi2_per_dof > 1e4
    found = beside_outlying(judged(fit), lambda rows: fit_without(fit, rows))
    assert found.explained
    assert found.left_out == {0: (row,)}
    assert f"row {row + 1} (near 5.02007 kHz, read while the response fell" in found.verdict


def test_a_row_that_is_left_out_of_a_decay_does_not_pull_the_start_of_its_piece(tmp_path):
    """It had no weight in what was left, but all of it in the start that was solved for."""
    time, rng = np.arange(200) / 800.0, np.random.default_rng(3)
    noise = 1e-4 * (rng.standard_normal(time.size) + 1j * rng.standard_normal(time.size))
    seen = 0.4 * np.exp((2j * np.pi * 3.0 - np.pi * 9.0) * time) + noise
    rows, header = np.column_stack([time, seen.real, seen.imag]), "t [s],Vx_I [V],Vx_Q [V]"
    np.savetxt(tmp_path / "decay.csv", rows, "%.9g", ",", header=header, comments="")
    case = import_case([tmp_path / "decay.csv"], tmp_path / "case", reference="9000 Hz").case
    model, sound = model_of(case, starting_device(case)), next(r for r in readings_of(case) if r.fitted)
    number = int(sound.row[row := sound.row.size // 2])
    wrong = sound.changed(lambda e: eqx.tree_at(lambda o: o.measured, e, e.measured.at[row].add(0.05)))

    def left(readings):
        joint = Joint(model, without_rows([readings], {0: (number,)}))
        return np.concatenate(joint.residual(joint.start, joint.fitted))

    np.testing.assert_allclose(left(wrong), left(sound), atol=1e-6)
