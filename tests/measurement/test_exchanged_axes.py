"""Channels or drives of a gyro that were exchanged in one of its sweeps, or in all."""

import numpy as np
import pytest

import memsgyro_jax as mg
from memsgyro_jax.base.errors import InputError
from memsgyro_jax.couplings.identify import identify
from memsgyro_jax.couplings.of_case import case_sweeps
from memsgyro_jax.measurement.case.quality import contradictions
from memsgyro_jax.measurement.exchanged_axes import all_exchanged, exchanged_axes, phasors_of_sweep, surely_exchanged


EXCHANGED = "`x60` reads as if its channels x and y were exchanged"
TURNED = "`x60` reads as if channel x inverted"


def wrote(folder, told):
    """A case of sweeps, whose design the records tell."""
    text = 'schema = "memsgyro-case/1"\nname = "bench"\ndevice = "single_mass"\n'
    for name, one in told:
        axis = "xy"[int(one.force[0, 1] != 0)]
        parts = one.motion.view(float)
        rows = np.column_stack([one.omega / (2 * np.pi), np.abs(one.force).max(1), parts])
        header = f"f [Hz],F_{axis} [V],Vx_I [V],Vx_Q [V],Vy_I [V],Vy_Q [V]"
        np.savetxt(folder / f"{name}.csv", rows, delimiter=",", header=header, comments="", fmt="%.9g")
        text += f'[[experiment]]\nname = "{name}"\nkind = "frequency_sweep"\nfile = "{name}.csv"\n'
        text += f'drive_axis = "{axis}"\nsettled = true\n'
    (folder / "case.toml").write_text(text)
    return folder


def sweeps(quality=(900, 1100)):
    """Of x at two drives and of y at two, in hertz and volts; the channel of y reads 1.35 times as much."""
    f = np.linspace(11_850.0, 12_150.0, 81)
    stiffness = np.array([[11_940.0**2, 6e4], [6e4, 12_052.0**2]])
    damping = np.array([[11_940.0 / quality[0], 0.3], [0.1, 12_052.0 / quality[1]]])
    dynamic = stiffness - f[:, None, None] ** 2 * np.eye(2) + 1j * f[:, None, None] * damping
    noise, found = np.random.default_rng(0), []
    for name, axis, volts in (("x20", 0, 0.02), ("x60", 0, 0.06), ("y20", 1, 0.02), ("y60", 1, 0.06)):
        z = 3e5 * volts * np.linalg.inv(dynamic)[:, :, axis] * [1.0, 1.35]
        z = z + 4e-5 * (noise.standard_normal(z.shape) + 1j * noise.standard_normal(z.shape))
        found.append((name, phasors_of_sweep(2 * np.pi * f, z, axis, np.full(f.size, volts))))
    return found


@pytest.mark.parametrize(
    ("what", "said"),
    [
        (("motion",), "its channels x and y were exchanged"),
        (("force",), "the other axis was driven"),
    ],
)
def test_what_was_exchanged_in_one_sweep_is_named(what, said):
    told = sweeps()
    assert exchanged_axes(told) == {}
    name, one = told[1]
    told[1] = name, one._replace(**{field: getattr(one, field)[:, ::-1] for field in what})
    ((named, sentence),) = exchanged_axes(told).items()
    assert named == name
    assert said in sentence
    assert all_exchanged(told) == ""


def test_of_all_sweeps_it_is_said_that_axes_are_exchanged():
    told = [(name, one._replace(motion=one.motion[:, ::-1])) for name, one in sweeps()]
    assert exchanged_axes(told) == {}
    assert "in `x20`, `x60`, `y20`, `y60` the axis moves that is not driven" in all_exchanged(told)
    assert all_exchanged(sweeps()) == ""


def test_axes_are_exchanged_beyond_doubt_where_each_was_driven():
    """Near the resonance of y alone a device that is driven along x moves along y, too."""
    told = [(name, one._replace(motion=one.motion[:, ::-1])) for name, one in sweeps()]
    assert surely_exchanged(sweeps()) == []
    assert surely_exchanged(told) == [all_exchanged(told)]
    assert all_exchanged(told[:2])
    assert surely_exchanged(told[:2]) == []


@pytest.mark.parametrize(
    ("turn", "said"), [(lambda z: z[:, ::-1], EXCHANGED), (lambda z: -z, TURNED)], ids=["exchanged", "inverted"]
)
def test_what_contradicts_itself_is_not_searched(turn, said, tmp_path):
    """A search of 94 to 114 s ended as "something is missing that no known effect explains"."""
    told = sweeps()
    assert contradictions(mg.load_case(wrote(tmp_path, told))) == ()
    name, one = told[1]
    told[1] = name, one._replace(motion=np.ascontiguousarray(turn(one.motion)))
    case = mg.load_case(wrote(tmp_path, told))
    for asked in (mg.diagnose, mg.fit, mg.compare):
        with pytest.raises(InputError, match=f"{said}.*put that right first"):
            asked(None, case)


def test_sweeps_with_exchanged_channels_are_refused_before_they_are_fitted(tmp_path):
    """A fit of 114 s named the sweep in its notes."""
    told = sweeps()
    told[1] = told[1][0], told[1][1]._replace(motion=np.ascontiguousarray(told[1][1].motion[:, ::-1]))
    with pytest.raises(InputError, match=f"{EXCHANGED}.*put that right first"):
        identify(case_sweeps(wrote(tmp_path, told)))


def test_of_two_sweeps_the_exchanged_one_is_named_where_no_resonance_is_clear(tmp_path):
    told = sweeps(quality=(4000, 3600))[1:3]
    told[0] = told[0][0], told[0][1]._replace(motion=np.ascontiguousarray(told[0][1].motion[:, ::-1]))
    with pytest.raises(InputError, match=f"shows a clear resonance: experiment {EXCHANGED}"):
        mg.load_case(wrote(tmp_path, told))
