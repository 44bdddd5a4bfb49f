"""Terms of the instrument: the port's promises, which of them a case can hold, and faults of a bench that they take."""

from dataclasses import replace
from types import SimpleNamespace

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from bench_case import ONE_AXIS, RESONATOR, bench
from lab.bent import bent_sweeps
from lab.die import Hidden
from lab.faults import Faults

from memsgyro_jax.base.errors import InputError
from memsgyro_jax.diagnosis.acceptance import _impossible
from memsgyro_jax.diagnosis.compare import compare
from memsgyro_jax.diagnosis.diagnose import diagnose
from memsgyro_jax.diagnosis.fit import beside_case, fit_case
from memsgyro_jax.diagnosis.instrument import beside_case_of, every_term, instrument_terms, knowledge
from memsgyro_jax.diagnosis.joint_residual import Joint
from memsgyro_jax.diagnosis.nuisances import _with_terms, add_terms, beside_terms
from memsgyro_jax.diagnosis.optimum import Optimum
from memsgyro_jax.diagnosis.promise import offers_of
from memsgyro_jax.diagnosis.scans import coverage
from memsgyro_jax.diagnosis.search import Search, start_search
from memsgyro_jax.effects import TERMS, FiniteSweepRate
from memsgyro_jax.effects.lock_in_terms import ReferencePhase
from memsgyro_jax.effects.trial import complaint
from memsgyro_jax.measurement.case import load_case
from memsgyro_jax.measurement.import_case import import_case
from memsgyro_jax.measurement.linear_start import starting_device
from memsgyro_jax.measurement.model import Model
from memsgyro_jax.measurement.model_file import read_model, write_model
from memsgyro_jax.measurement.readings import model_of, readings_of


CLOCK = 5.0  # s from row to row
HIDDEN = Hidden()
OMEGA = 2 * np.pi * 68.6
WEAK = 0.012
BY_RECORDS = "reference_phase by record"


def slow(*case):
    return pytest.param(*case, marks=pytest.mark.slow)


def case_of(seed=0, **faults):
    return bench(protocol=replace(ONE_AXIS, faults=Faults(**faults)), die=RESONATOR, seed=seed).case


def searched(case) -> Search:
    """The search over the terms alone, from the device that the records show."""
    terms = instrument_terms(case)
    model = model_of(case, starting_device(case)).with_effect(*terms)
    search = start_search(case, Joint(model, (*readings_of(case), *knowledge(terms))), 0.01, (), lambda text: None)
    add_terms(search, search.rank())
    return search


def numbers(search, label):
    """Estimate and standard deviation of a term that was found."""
    (place,) = [i for i in search.accepted if search.joint.model.effects[i].label == label]
    mine = search.joint.of_effect(place)
    return search.optimum.vector[mine], search.optimum.std[np.isin(search.optimum.free, mine)]


@pytest.mark.parametrize("kind", TERMS, ids=lambda kind: kind.name)
@pytest.mark.parametrize("axes", [1, 2])
def test_a_term_keeps_the_promises_of_its_port(kind, axes):
    size = 2 * axes if kind.parts else 1
    term = kind(np.zeros(size), np.ones((1, 1, size)))
    assert complaint(term, axes) == ""
    assert term.of_instrument


def test_a_case_holds_no_term_of_which_it_has_one_group_alone():
    """One drive level, one record: a level or a gain of its own would be the device's. Without a clock nothing
    drifts.
    """
    labels = [term.label for term in instrument_terms(case_of())]
    assert labels == [
        "lock_in_memory", "lock_in_memory by record", "reference_phase", "reference_phase by record",
        "lock_in_background", "lock_in_feedthrough", "drive_level", "record_gain", "frequency_offset",
    ]  # fmt: skip
    assert {"frequency_drift", "gain_drift"} < {term.label for term in instrument_terms(case_of(dwell=CLOCK))}
    whole = case_of()
    (alone,) = [replace(r, **_only(r, r.sweeps[0])) for r in whole.records if r.name == "sweep"]
    labels = [term.label for term in instrument_terms(replace(whole, records=(alone,)))]
    assert labels == ["lock_in_memory", "reference_phase", "lock_in_background", "lock_in_feedthrough"]


def test_a_decay_from_an_unknown_start_has_no_phase_of_the_reference(tmp_path):
    """Its start takes it: the number of a decay beside sweeps was never held."""
    time = np.arange(200) / 800.0
    seen = 0.4 * np.exp((2j * np.pi * 3.0 - np.pi * 9.0) * time)
    rows = np.column_stack([time, seen.real, seen.imag])
    np.savetxt(tmp_path / "decay.csv", rows, "%.9g", ",", header="t [s],Vx_I [V],Vx_Q [V]", comments="")
    decay = import_case([tmp_path / "decay.csv"], tmp_path / "case", reference="9000 Hz").case
    assert not [t for t in instrument_terms(decay) if t.name == "reference_phase"]
    swept = case_of()
    both = replace(swept, records=(*swept.records, *decay.records))
    sizes = [t.strength.size for case in (swept, both) for t in instrument_terms(case) if t.label == BY_RECORDS]
    assert sizes == [len(swept.records)] * 2


def test_one_drift_goes_on_from_record_to_record_by_one_clock(tmp_path):
    """Records that begin at zero have each a clock of their own."""
    case = load_case(bent_sweeps(tmp_path / "one", (5, 20), rows=21, drift=1e-8))
    (term,) = [t for t in instrument_terms(case) if t.label == "frequency_drift throughout"]
    assert term.strength.size == 1
    first, last = min(r.time[0] for r in case.records), max(r.time[-1] for r in case.records)
    np.testing.assert_allclose(np.asarray([term.begin, term.span]), [[first] * 2, [last - first] * 2])
    model = model_of(case, starting_device(case)).with_effect(
        eqx.tree_at(lambda t: t.strength, term, jnp.array([3e-6]))
    )
    kept = read_model(write_model(model, tmp_path / "m.toml")).effects
    assert [(effect.label, float(effect.strength[0])) for effect in kept] == [("frequency_drift throughout", 3e-6)]
    apart = replace(case, records=tuple(replace(r, time=r.time - r.time[0]) for r in case.records))
    assert "frequency_drift throughout" not in {t.label for t in instrument_terms(apart)}


def _only(record, rows):
    names = ("lines", "frequency", "drive", "temperature", "bias_voltage", "rate", "phasors")
    return {name: getattr(record, name)[rows] for name in names}


@pytest.mark.parametrize(
    ("label", "true", "faults"),
    [
        ("reference_phase", 0.026, {"phase": 0.026}),
        slow("lock_in_background", (2e-3, 1e-3), {"background": 2e-3 + 1e-3j}),
        slow("lock_in_feedthrough", (0.0, 0.2), {"feedthrough": 0.2j}),
        slow("lock_in_memory", np.exp(-2.5), {"dwell": CLOCK, "filter_time": 2.0}),
        slow("gain_drift", 0.03, {"dwell": CLOCK, "gain_drift": 0.03}),
        slow("phase_drift", 0.05, {"dwell": CLOCK, "phase_drift": 0.05}),
        slow("frequency_drift", 2e-3, {"dwell": CLOCK, "pull": 2e-3}),
    ],
)
def test_a_fault_of_the_instrument_is_found_with_its_size(label, true, faults):
    found = searched(case_of(**faults))
    assert found.base.chi2_per_dof > 2
    estimate, std = numbers(found, label)
    true = np.atleast_1d(true)
    assert np.all(np.abs(estimate[: true.size] - true) < 4 * std[: true.size])
    assert found.steps[-1].fit.chi2_per_dof < 1.7  # that of the case without a fault is 1.49
    assert len(found.accepted) == 1


def test_levels_that_are_off_are_told_against_the_first():
    found = searched(case_of(levels=(0.03, -0.04, 0.035)))
    estimate, std = numbers(found, "drive_level")
    true = np.array([0.96, 1.035]) / 1.03 - 1
    assert np.all(np.abs(estimate[:2] - true) < 4 * std[:2])
    assert std[2] == pytest.approx(0.05)  # the level of the record that is not fitted is known as before


@pytest.mark.slow
def test_what_the_instrument_does_is_there_once_where_more_of_it_is_found():
    case = case_of(phase=0.026, levels=(0.03, -0.04, 0.035))
    (phase, level) = (t for t in instrument_terms(case) if t.label in ("reference_phase", "drive_level"))
    joint = Joint(model_of(case, starting_device(case)), readings_of(case))
    search = start_search(case, joint, 0.05, (), lambda text: None)
    for term in (phase, level):
        search = beside_terms(_with_terms(search, [term]), search, ())
    assert [effect.label for effect in search.joint.model.effects] == ["reference_phase", "drive_level"]
    assert [r.experiment.name for r in search.joint.readings if np.all(r.record < 0)] == ["drive_level"]
    assert search.optimum.chi2 / search.optimum.dof < 1.7


@pytest.mark.parametrize(
    ("label", "size", "faults"),
    [
        slow("capacitive_feedthrough", 0.2 / OMEGA, {"capacitance": 0.2j / OMEGA}),
        ("lock_in_feedthrough", 0.2, {"feedthrough": 0.2j}),
        ("lock_in_feedthrough", WEAK, {"capacitance": 1j * WEAK / OMEGA}),  # too weak to tell how it grows
    ],
)
def test_a_feedthrough_grows_with_the_frequency_where_the_sweeps_say_so(tmp_path, label, size, faults):
    """A constant one beside a capacitive one moves the quality factor, and what it leaves passed for slow noise."""
    case = case_of(**faults)
    (term,) = [t for t in instrument_terms(case) if t.label == "lock_in_feedthrough"]
    joint = Joint(model_of(case, starting_device(case)), readings_of(case))
    search = start_search(case, joint, 0.05, (), lambda text: None)
    found = beside_terms(_with_terms(search, [term]), search, ())
    (place,) = found.given
    assert found.joint.model.effects[place].label == label
    mine = found.joint.of_effect(place)
    std = found.optimum.std[np.isin(found.optimum.free, mine)]
    assert np.all(np.abs(found.optimum.vector[mine] - [0.0, size]) < 4 * std)
    again = read_model(write_model(found.joint.at(found.optimum.vector), tmp_path / "m.toml"))
    assert beside_case_of(case, again).effects[0].label == label


def late(case, delay):
    """The same bench behind a converter that takes `delay` [s], which turns what leaks past the device as well."""
    sweeps = (
        replace(r, phasors=r.phasors * np.exp(-1j * (r.frequency - OMEGA) * delay)[:, None])
        if r.kind == "frequency_sweep"
        else r
        for r in case.records
    )
    return replace(case, records=tuple(sweeps))


@pytest.mark.parametrize("delay", [0.0, slow(0.012), 5e-3])
def test_what_comes_late_as_a_whole_is_told(tmp_path, delay):
    """Whole turns of the phase come before its slope shows, and what leaks past the device is late as well. A third and
    four fifths of a period of the resonance; without it nothing is taken for it.
    """
    case = late(case_of(feedthrough=0.2j, phase=0.3), delay)
    terms = [t for t in instrument_terms(case) if t.label in ("lock_in_feedthrough", "reference_phase")]
    joint = Joint(model_of(case, starting_device(case)), readings_of(case))
    search = start_search(case, joint, 0.05, (), lambda text: None)
    found = beside_terms(_with_terms(search, terms), search, ())
    labels = [found.joint.model.effects[place].label for place in found.given]
    if not delay:
        assert labels == ["reference_phase", "lock_in_feedthrough"]
        return
    assert labels == ["reference_phase", "lock_in_feedthrough", "late_readings"]
    mine = found.joint.of_effect(found.given[-1])
    std = found.optimum.std[np.isin(found.optimum.free, mine)]
    assert np.all(np.abs(found.optimum.vector[mine] - delay) < 4 * std)
    assert np.all(std < 0.1 * delay)
    assert found.optimum.chi2 / found.optimum.dof < 1.7
    again = read_model(write_model(found.joint.at(found.optimum.vector), tmp_path / "m.toml"))
    (term,) = [effect for effect in beside_case_of(case, again).effects if effect.label == "late_readings"]
    assert float(term.middle) == pytest.approx(OMEGA, rel=0.1)


def test_a_model_that_was_found_explains_its_case_from_its_file(tmp_path):
    """With what the instrument does; beside a case with other rows it is refused."""
    case = case_of(phase=0.026)
    (term,) = [t for t in instrument_terms(case) if t.label == "reference_phase"]
    found = fit_case(case, [term])
    again = read_model(write_model(found.model, tmp_path / "m.toml"))
    assert compare(again, case, fitted=False).fit.optimum.chi2 == pytest.approx(found.optimum.chi2, rel=1e-9)
    several = ReferencePhase(np.ones(3), np.ones((1, 1, 3)))
    with pytest.raises(InputError, match=r"reference_phase.*with 3 numbers.*has 1"):
        compare(again.with_only([several]), case, fitted=False)
    with pytest.raises(InputError, match=r"shows velocity, that of the case .* displacement"):
        compare(Model(found.model.device, order=1), case, fitted=False)


@pytest.mark.parametrize("settled", [True, slow(False)])
def test_what_a_term_promises_is_what_a_program_derives(settled):
    """Of a linear device, of which 8 % is left of the row before after 0.5 s."""
    whole = case_of(dwell=0.5)
    case = replace(whole, records=tuple(replace(r, settled=settled) if r.kind == "frequency_sweep" else r
                                        for r in whole.records))  # fmt: skip
    terms = every_term(case)
    model = model_of(case, starting_device(case)).with_effect(*terms)
    joint = Joint(model, readings_of(case))
    free = np.arange(joint.start.size)
    residual, slopes = joint.linearise(joint.start, np.eye(free.size), joint.fitted)
    base = joint.base()
    bare = Optimum(joint.start, base, residual, slopes[:, base], np.zeros((0, base.size)), True, 1)
    offers = offers_of(beside_case(case, joint, bare), terms)
    for place, (term, offer) in enumerate(zip(terms, offers, strict=True)):
        derived = slopes[:, joint.of_effect(place)]
        size = np.linalg.norm(derived, axis=0)
        near = 0.05 if getattr(term, "last", False) else 1e-3  # these see the row before, here with its noise
        assert np.all(np.linalg.norm(offer.slopes - derived, axis=0) <= near * size + 1e-9), term.label


def test_sound_instruments_have_no_term():
    """Of five benches at a level of 1 %."""
    assert sum(bool(searched(case_of(seed)).accepted) for seed in range(5)) <= 1


def diagnosed(seed=0, hidden=HIDDEN, **faults):
    protocol = replace(ONE_AXIS, faults=Faults(**faults))
    return diagnose(None, bench(hidden, protocol=protocol, die=RESONATOR, seed=seed).case)


@pytest.mark.slow  # `test_diagnose.py::test_a_delay_that_is_a_phase_as_well_is_not_told_from_it` says it of one more
@pytest.mark.parametrize(
    ("label", "faults"),
    [
        ("drive_level", {"levels": (0.03, -0.04, 0.035)}),
        ("reference_phase", {"phase": 0.026}),
        ("lock_in_filter", {"dwell": CLOCK, "filter_time": 2.0}),
    ],
)
def test_a_fault_of_the_instrument_is_no_effect_of_the_device(label, faults):
    found = diagnosed(**faults)
    assert found.verdict == "instrument_only"
    assert [term.label for term in found.instrument] == [label]
    assert found.accepted == ()
    assert found.to_dict()["instrument"][0]["name"] == label
    assert label in str(found)
    assert found.device.effects == ()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("terms", "faults"),
    [([], {}), (["drive_level"], {"levels": (0.03, -0.04, 0.035)}), (["reference_phase"], {"phase": 0.026})],
)
def test_an_effect_is_found_beside_a_fault_and_without_one(terms, faults):
    found = diagnosed(hidden=Hidden(cubic_stiffness_x=1.0), **faults)
    assert found.verdict == "found"
    assert [a.label for a in found.accepted] == ["cubic_stiffness x"]
    assert [term.label for term in found.instrument] == terms
    assert abs(found.accepted[0].estimate[0] - 1.0) < 4 * found.accepted[0].std[0]


def test_the_clock_of_a_record_rules_the_rate_of_its_sweeps():
    """Without one any rate may be; by it none much faster, and none at all beside rows whose steps are predicted."""
    free, clocked = case_of(), case_of(dwell=CLOCK)
    assert coverage(free).sweep_rate == np.inf
    (record, *_) = (r for r in clocked.records if r.kind == "frequency_sweep")
    steps = max(np.max(np.abs(np.diff(record.frequency[rows]))) for rows in record.sweeps)
    assert coverage(clocked).sweep_rate >= steps / CLOCK
    rate = coverage(clocked).sweep_rate
    unsettled = replace(clocked, records=tuple(replace(r, settled=False) if r.kind == "frequency_sweep" else r
                                               for r in clocked.records))  # fmt: skip
    for case, speed, impossible in ((free, 9 * rate, False), (clocked, rate, False), (clocked, 2 * rate, True),
                                    (unsettled, 0.1 * rate, True)):  # fmt: skip
        joint = Joint(model_of(case, starting_device(case)).with_effect(FiniteSweepRate(speed)), readings_of(case))
        why = _impossible(joint, 0, SimpleNamespace(vector=joint.start), case)
        assert ("clock" in why) == impossible
