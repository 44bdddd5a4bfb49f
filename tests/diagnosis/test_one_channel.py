"""Records of a device with two axes of which one channel was not recorded."""

import sys
from pathlib import Path

import numpy as np
import pytest

from memsgyro_jax.diagnosis.compare import compare
from memsgyro_jax.measurement.case import assess, load_case, write_case


sys.path.insert(0, str(Path(__file__).parents[1] / "measurement" / "case"))
from bench import KX, MASS, TOML, write_bench


def one_channel(folder, kinds, kept):
    """The bench with some of its records, of which the columns of one channel are kept."""
    write_bench(folder)
    head, *sections = TOML.split("[[experiment]]")
    chosen = [s for s in sections if any(f'name = "{kind}"' in s for kind in kinds)]
    (folder / "case.toml").write_text("[[experiment]]".join([head, *chosen]))
    for kind in kinds:
        path = folder / f"{kind}.csv"
        lines = [line.split(",") for line in path.read_text().splitlines()]
        own = [k for k, name in enumerate(lines[0]) if not name.startswith("V") or name.startswith(kept)]
        path.write_text("\n".join(",".join(line[k] for k in own) for line in lines) + "\n")
    return load_case(folder)


@pytest.fixture(scope="module")
def swept(tmp_path_factory):
    return one_channel(tmp_path_factory.mktemp("bench") / "case", ["sweep_x"], "Vx")


def test_a_sweep_of_one_channel_is_compared_and_what_it_cannot_tell_is_said(swept):
    found = compare(None, swept)
    assert found.explained
    assert {check.channel for check in found.checks} == {"x"}
    assert [error.count for error in found.errors] == [82, 82]
    values = {e.name: e for e in found.fit.estimates}
    assert abs(values["kxx/m"].value - KX / MASS) < 4 * values["kxx/m"].std
    assert not np.isfinite(values["dyy/m"].std) or values["dyy/m"].std > 0.1 * values["dyy/m"].value
    (force,) = found.fit.missing_forces
    assert np.isfinite(force.std[:, 0]).all()
    assert np.isinf(force.std[:, 1]).all()


def test_check_names_the_channel(swept):
    assert any("channel y was not recorded" in warning for warning in assess(swept).warnings)
    noise = assess(swept).records[0].noise
    assert noise == pytest.approx(1e-5, rel=0.25)


def test_it_is_written_as_it_was_read(swept, tmp_path):
    write_case(swept, tmp_path / "again")
    again = load_case(tmp_path / "again").records[0]
    assert again.channels == [0]
    np.testing.assert_array_equal(again.phasors, swept.records[0].phasors)
