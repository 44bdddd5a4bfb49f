"""The effect that explains most by itself is the one whose fit does, not the one whose slope promises it."""

from types import SimpleNamespace

import numpy as np
import pytest

import memsgyro_jax as mg
from memsgyro_jax.diagnosis.best_single import best_single


def optimum(chi2):
    return SimpleNamespace(chi2=chi2, frozen=(), free=np.arange(8), dof=476, residual=np.zeros(484))


@pytest.mark.parametrize(("p_values", "best", "fitted"), [
    ((1e-37, 1e-30, 1e-9, 1e-4), "three", 3), ((1e-37, 0.2, 1e-9, 1e-4), "one", 1), ((0.2, 0.3, 0.4, 0.5), None, 0),
])  # fmt: skip
def test_the_first_few_are_fitted(p_values, best, fitted):
    """The first two stop in another valley; what follows one that helps by chance alone is not looked at."""
    chi2, asked = dict(zip((10, 11, 12, 13), (1.3e6, 1.4e6, 486.0, 480.0), strict=True)), []
    announced: list[tuple[int, ...]] = []
    labels = dict(zip(chi2, ("one", "two", "three", "four"), strict=True))
    search = SimpleNamespace(
        level=0.05,
        optimum=optimum(1.5e6),
        given=(),
        joint=SimpleNamespace(
            model=SimpleNamespace(effects={k: SimpleNamespace(label=v) for k, v in labels.items()}),
            together=lambda effects, later: announced.append((*effects, *later)),
            named=lambda places: [],
        ),
        refit=lambda places, slopes: asked.append(places[0]) or optimum(chi2[places[0]]),
    )
    first = SimpleNamespace(places=tuple(chi2), order=np.arange(4), p_values=p_values, slopes=[None] * 4)
    found = best_single(search, first)
    assert (found and found.label) == best
    assert len(asked) == fitted
    assert announced == [tuple(asked)]  # through one program


@pytest.mark.slow
def test_a_channel_eight_times_as_sensitive_as_the_other(tmp_path):
    """It took a climb over three terms of the lock-in, dry friction and a cross stiffness: 128 s, and now seven."""
    rng, turn = np.random.default_rng(4), 2 * np.pi
    hertz, quality = np.array([14200.0, 14900.0]), np.array([8000.0, 5000.0])
    stiffness = np.diag((turn * hertz) ** 2) + 6e6 * (1 - np.eye(2))
    damping = np.diag(turn * hertz / quality)
    text = 'schema = "memsgyro-case/1"\nname = "gain"\ndevice = "single_mass"\n[drive]\nunit = "V"\n[design]\n'
    for axis, name in enumerate("xy"):
        swept = hertz[axis] + np.linspace(-6.0, 6.0, 121)
        omega = turn * swept[:, None, None]
        response = np.linalg.inv(stiffness - omega**2 * np.eye(2) + 1j * omega * damping)[:, :, axis]
        read = 8e4 * response * [1.0, 8.0] + 2e-4 * (rng.normal(size=(121, 2)) + 1j * rng.normal(size=(121, 2)))
        rows = np.column_stack([swept, np.full(121, 0.02), read.view(float).reshape(121, 4)])
        header = f"f [Hz],F_{name} [V],Vx_I [V],Vx_Q [V],Vy_I [V],Vy_Q [V]"
        np.savetxt(tmp_path / f"{name}.csv", rows, "%.9g", ",", header=header, comments="")
        text += (
            f'[[experiment]]\nname = "{name}"\nkind = "frequency_sweep"\nfile = "{name}.csv"\ndrive_axis = "{name}"\n'
        )
    (tmp_path / "case.toml").write_text(text)
    told = []
    found = mg.diagnose(None, mg.load_case(tmp_path), tell=told.append)
    assert [a.name for a in found.accepted] == ["pickoff_scale_error"]
    assert not any("climb" in one for one in told)
    assert found.final.chi2_per_dof < 1.15
