"""A type checker, and so an editor, sees every public name and signature."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

import memsgyro_jax
from memsgyro_jax.app.commands.templates import EFFECT


SCRIPT = """
import memsgyro_jax as mg

gyro = mg.SingleMassGyro.chi2010().with_effect(mg.effects.CubicStiffness("x", 8e8))
readout = mg.DirectReadout(scale=1e5, noise_density=1e-6)
controller = mg.DampingCompensation(mg.Tone(600.0, 53.95))
loop = mg.ClosedLoop(gyro, readout, mg.ExtendedKalmanFilter.for_device(gyro, readout), controller)
trace = mg.simulate(loop, mg.Step(at=0.05, after=1.0), sample_rate=100e3, duration=0.1, seed=0)
lot = mg.sweep(loop, mg.Spread.relative(0.15), dies=8, sample_rate=100e3, duration=0.1)
print(trace, trace.to_xarray(), lot.plot(), mg.effects.CATALOGUE)
better = mg.fit(gyro, mg.load_case("bench"))
"""
OWN = """

EFFECT = SoftStop(0, 1e8)


class Push(mg.AbstractController[tuple[()]]):
    gain: Array = eqx.field(converter=jnp.asarray, default=1e-3)

    def init(self) -> tuple[()]:
        return ()

    def command(
        self, state: tuple[()], estimate: mg.Estimate, clock: mg.Clock
    ) -> tuple[tuple[Array, Array], tuple[()]]:
        return (-self.gain * estimate.motion[2], jnp.zeros(())), state


class Sees(mg.AbstractObserver[tuple[Array, Array]]):
    model = mg.SingleMassGyro.model

    def init(self) -> tuple[Array, Array]:
        return jnp.zeros(()), jnp.zeros(())

    def update(
        self, state: tuple[Array, Array], measured: tuple[Array, Array], force: tuple[Array, Array], clock: mg.Clock
    ) -> tuple[Array, Array]:
        return measured

    def estimate(self, state: tuple[Array, Array]) -> mg.Estimate:
        return mg.Estimate((*state, *state), (0.0,) * 8, (0.0, 0.0), self.model)


class Doubled(mg.DirectReadout):
    scale: tuple[Array, Array]
"""
MISSPELT = {
    "mg.simulate(loop, sample_rate=100e3, duratoin=0.1)": 'Unexpected keyword argument "duratoin" for "simulate"',
    "mg.DampingCompensation(tone=mg.Tone(600.0, 53.95))": 'Unexpected keyword argument "tone"',
    "mg.simulat(loop)": 'Module has no attribute "simulat"',
    "mg.SingleMassGyro.chi2011()": 'has no attribute "chi2011"',
}
# What other packages say of themselves takes most of the time of a first run; nothing of it is checked here.
FOREIGN = (
    "matplotlib",
    "scipy",
    "xarray",
    "zarr",
    "rich",
    "pydantic",
    "optimistix",
    "diffrax",
    "lineax",
    "pint",
    "pandas",
)


@pytest.mark.parametrize(
    "skipped", [(*FOREIGN, "jax", "numpy"), pytest.param(FOREIGN, marks=pytest.mark.slow)], ids=["quick", "jax"]
)
def test_a_users_script_is_checked(skipped, tmp_path, pytestconfig):
    settings = ["[mypy]", *(f"[mypy-{name}.*]\nfollow_imports = skip" for name in skipped)]
    (tmp_path / "mypy.ini").write_text("\n".join(settings))
    names = sorted({*memsgyro_jax.__all__})
    (tmp_path / "right.py").write_text(SCRIPT + f"print({', '.join(f'mg.{name}' for name in names)})\n")
    (tmp_path / "own.py").write_text(EFFECT.format(name="own.py") + "import memsgyro_jax as mg\n" + OWN)
    (tmp_path / "wrong.py").write_text(SCRIPT + "\n".join(MISSPELT))
    package = Path(memsgyro_jax.__file__).parent
    assert (package / "py.typed").exists()
    # Found like an installed package, whose own lines mypy does not judge.
    environment = {**os.environ, "PYTHONPATH": str(package.parent)}
    kept = str(pytestconfig.cache.mkdir(f"mypy-{len(skipped)}"))
    done = subprocess.run(
        [sys.executable, "-m", "mypy", "--cache-dir", kept, "--no-error-summary", "--strict", "right.py", "own.py",
         "wrong.py"],
        cwd=tmp_path, env=environment, capture_output=True, text=True, check=False,
    )  # fmt: skip
    told = [line for line in done.stdout.splitlines() if ": error: " in line]
    assert [line for line in told if not line.startswith("wrong.py")] == []
    last = SCRIPT.count("\n") + 1
    for number, (line, complaint) in enumerate(MISSPELT.items(), last):
        found = [text for text in told if text.startswith(f"wrong.py:{number}:")]
        assert len(found) == 1, (line, told)
        assert complaint in found[0]
    assert len(told) == len(MISSPELT)
