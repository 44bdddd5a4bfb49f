"""Programs whose tracing is kept: the same numbers, found again by another process, and never another one's."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from memsgyro_jax.base import kept as keeping
from memsgyro_jax.base.concrete import settled
from memsgyro_jax.base.linalg import inverse, product
from memsgyro_jax.device.conditions import Conditions
from memsgyro_jax.effects import CubicStiffness


MATRIX, VECTOR = np.array([[2.0, 1.0], [0.5, 3.0]]), np.array([1.0, -1.0])


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.setattr(keeping, "_folder", lambda: tmp_path)
    return tmp_path


@pytest.fixture
def untraced(monkeypatch):
    """What was traced since."""
    found = []

    def traced(*given, made=keeping._traced):
        found.append(given)
        return made(*given)

    monkeypatch.setattr(keeping, "_traced", traced)
    return found


def test_another_process_runs_it_without_tracing_it(folder, untraced):
    first = keeping.kept(inverse)(MATRIX)
    again = keeping.kept(inverse)(MATRIX)  # as empty as in another process
    assert len(untraced) == len(list(folder.iterdir())) == 1
    np.testing.assert_array_equal(first, again)
    np.testing.assert_allclose(first, np.linalg.inv(MATRIX), rtol=1e-14)


def test_what_is_damaged_on_disk_is_made_again(folder, untraced):
    keeping.kept(inverse)(MATRIX)
    (file,) = folder.iterdir()
    for content in (b"", file.read_bytes()[:100], b"no program"):
        file.write_bytes(content)
        np.testing.assert_allclose(keeping.kept(inverse)(MATRIX) @ MATRIX, np.eye(2), atol=1e-15)
    assert len(untraced) == 4


def test_structure_shape_and_function_tell_programs_apart(folder, untraced):
    call = keeping.kept(product)
    call(MATRIX, VECTOR), call(2 * MATRIX, VECTOR), call(np.stack([MATRIX, MATRIX]), np.stack([VECTOR, VECTOR]))
    keeping.kept(inverse)(MATRIX), keeping.kept(inverse)(MATRIX + 0j)
    assert len(untraced) == 4


def test_trees_go_in_and_come_out(folder, untraced):
    tree = Conditions(rate=0.1).rows(3), {"effect": CubicStiffness("x", 2.0), "none": None}
    for _ in range(2):
        out = keeping.kept(settled)(tree)
        assert jax.tree.structure(out) == jax.tree.structure(tree)
        np.testing.assert_array_equal(out[0].rate, np.full(3, 0.1))
        assert out[1]["effect"].label == "cubic_stiffness x"
        assert float(out[1]["effect"].strength) == 2.0
    assert len(untraced) == 1


def test_what_a_user_wrote_is_not_kept(folder):
    class Own(CubicStiffness):
        """An effect of another package."""

    def nested(value):
        return 2 * value

    assert float(keeping.kept(nested)(jnp.asarray(2.0))) == 4.0
    assert float(keeping.kept(settled)(Own("x", 3.0)).strength) == 3.0
    assert float(keeping.kept(settled)((CubicStiffness("x", 1.0), nested))[0].strength) == 1.0
    assert not list(folder.iterdir())


def test_it_can_be_part_of_another_program(folder):
    assert float(jax.jit(keeping.kept(inverse))(jnp.eye(1) * 4)[0, 0]) == 0.25
    slope = jax.grad(lambda x: keeping.kept(inverse)(x * jnp.eye(1))[0, 0])(2.0)
    assert abs(float(slope) + 0.25) < 1e-15
    assert not list(folder.iterdir())


def test_few_sources_stay_on_disk(tmp_path):
    for number in range(keeping._SOURCES + 3):
        (tmp_path / "traced" / f"source{number}").mkdir(parents=True)
    keeping._folder_beside.__wrapped__(str(tmp_path))
    left = [file.name for file in (tmp_path / "traced").iterdir()]
    assert len(left) == keeping._SOURCES
    assert keeping._source() in left
