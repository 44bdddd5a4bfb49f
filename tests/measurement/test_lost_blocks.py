"""A rate table of which blocks are lost and whose stamps jitter: each row is that of its block."""

import sys
from pathlib import Path

import equinox as eqx
import numpy as np
import pytest

from memsgyro_jax.base.errors import InputError
from memsgyro_jax.measurement.case import load_case
from memsgyro_jax.measurement.linear_start import design_device
from memsgyro_jax.measurement.readings import model_of, readings_of


sys.path.insert(0, str(Path(__file__).parent / "case"))
from bench import TOML, write_bench


BLOCK = 1e-3  # s
LOST = [*range(50, 58), 17, 96]  # where the rate stands


def rate_table(folder, lost=(), jitter=0.0, uneven=False, twice=()):
    write_bench(folder)
    head, *sections = TOML.split("[[experiment]]")
    rate = next(s for s in sections if 'name = "rate"' in s) + ("uneven = true\n" if uneven else "")
    (folder / "case.toml").write_text("[[experiment]]".join([head, rate]))
    header, *rows = (folder / "rate.csv").read_text().splitlines()
    table = np.delete(np.array([[float(v) for v in row.split(",")] for row in rows]), list(lost), axis=0)
    table[:, 0] += jitter * BLOCK * np.random.default_rng(1).uniform(-1, 1, len(table))
    for row in twice:
        table[row, 0] = table[row - 1, 0] + 0.2 * BLOCK
    np.savetxt(folder / "rate.csv", table, delimiter=",", header=header, comments="", fmt="%.9g")
    return load_case(folder)


def test_rows_are_those_of_their_blocks(tmp_path):
    whole, part = rate_table(tmp_path / "a"), rate_table(tmp_path / "b", LOST, 0.3, uneven=True)
    model, predict = model_of(whole, design_device(whole)), eqx.filter_jit(lambda one, bench: one.predict(bench))
    (every,), (some,) = readings_of(whole), readings_of(part)
    want, got = (np.asarray(predict(one.experiment, model)) for one in (every, some))
    np.testing.assert_allclose(got, want, rtol=1e-9, atol=1e-12)
    kept = np.delete(np.arange(120), LOST)
    np.testing.assert_array_equal(np.flatnonzero(some.record == 0), kept)
    np.testing.assert_array_equal(some.row[kept], np.arange(kept.size))
    np.testing.assert_array_equal(np.asarray(some.experiment.measured)[kept], part.records[0].phasors)
    assert np.isinf(np.asarray(some.experiment.noise.std)[LOST]).all()


def test_without_the_word_it_is_refused_and_a_block_has_one_row(tmp_path):
    with pytest.raises(InputError, match="uneven = true"):
        rate_table(tmp_path / "a", LOST)
    with pytest.raises(InputError, match="later block"):
        rate_table(tmp_path / "b", uneven=True, twice=[30])
