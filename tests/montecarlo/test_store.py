"""The store of a sweep: damage is seen and mended, and several processes share the work."""

import functools
import json
import shutil
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

from memsgyro_jax.base.errors import InputError
from memsgyro_jax.montecarlo import layout as layouts
from memsgyro_jax.montecarlo.folder import place_of
from memsgyro_jax.montecarlo.layout import LABELS, PROCESSOR, DieArray, Layout
from memsgyro_jax.montecarlo.standing import standing_of
from memsgyro_jax.montecarlo.status import LOST, STATUS
from memsgyro_jax.montecarlo.store import discard, opened


DIES, BLOCK = 40, 16
LAYOUT = Layout(
    {"left": DieArray((), (), "1"), "right": DieArray(("window",), (3,), "rad/s"), "absent": DieArray((), (), "1")},
    {"time": ("window", np.arange(3.0), "s")},
    {
        "fingerprint": "0123456789abcdef",
        "versions": "python 3, jax 0",
        PROCESSOR: "this",
        LABELS: {"window": ["a", "b", "c"]},
    },
)


@pytest.fixture(scope="module", autouse=True)
def small_shards():
    """Blocks 0 and 1 in one shard, 2 in another."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(layouts, "SHARD", 2 * BLOCK)
        yield


def rows_of(number: int) -> dict[str, np.ndarray]:
    """A block as a sweep computes it: a column like another's neighbour, one that is never a number, a lost die."""
    dies = np.arange(number * BLOCK, (number + 1) * BLOCK)
    status = np.where(dies == 5, LOST, 0).astype(np.int8)
    right = np.sin(dies[:, None] + 0.1 * np.arange(3))
    return {"left": np.cos(dies), "right": right, "absent": np.full(BLOCK, np.nan), STATUS: status}


WANTED = {name: np.concatenate([rows_of(n)[name] for n in range(3)])[:DIES] for name in rows_of(0)}


def gone_on(path: Path, dies: int = DIES, layout: Layout = LAYOUT) -> tuple[list[int], dict, list[str]]:
    """Which blocks were computed to complete a store, the rows, and what was said."""
    computed = []
    with opened(path, layout, dies, BLOCK, resume=True) as store:
        for number in store.unfinished():
            computed.append(number)
            store.write(number, rows_of(number))
    return computed, store.rows, store.notes


def assert_wanted(rows, dies: int = DIES) -> None:
    for name, values in WANTED.items():
        assert np.asarray(rows[name])[:dies].tobytes() == values[:dies].tobytes(), name


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """A finished store."""
    path = tmp_path_factory.mktemp("whole") / "dies.zarr"
    assert gone_on(path)[::2] == ([0, 1, 2], [])
    return path


@pytest.fixture
def broken(whole, tmp_path):
    """A copy to break."""
    return Path(shutil.copytree(whole, tmp_path / "dies.zarr"))


def test_a_store_is_gone_on_with_and_grows(tmp_path):
    path = tmp_path / "dies.zarr"
    assert gone_on(path, 20)[::2] == ([0, 1], [])
    assert gone_on(path, 20)[::2] == ([], [])
    computed, rows, notes = gone_on(path)
    assert (computed, notes) == ([1, 2], [])
    assert_wanted(rows)
    with xr.open_zarr(path, consolidated=False, mask_and_scale=False) as found:
        assert set(found.data_vars) == set(WANTED)
        assert list(found["right"].sel(window=["c", "a"])["window"].values) == ["c", "a"], "names, without this package"
        assert_wanted(found.load())
    assert [file.name for file in tmp_path.iterdir()] == ["dies.zarr"], "no lease, no draft"


def test_a_block_may_be_written_while_the_next_is_computed(tmp_path):
    """Written late by one, none is given twice, the last is asked for, and what is done is given up."""
    path, computed, last = tmp_path / "dies.zarr", [], None
    with opened(path, LAYOUT, DIES, BLOCK, resume=False) as store:
        for number in store.unfinished():
            computed.append(number)
            held = {file.name.split(".")[0] for file in store._leases.folder.glob("?.?")}
            assert held == {str(n) for n in (number, last) if n is not None}
            if last is not None:
                store.write(last, rows_of(last))
            last = number
        assert not list(store._leases.folder.glob("?.?"))
        assert_wanted(store.rows)
    assert computed == [0, 1, 2, None]


def test_a_finished_store_is_read_where_nothing_can_be_written(broken, monkeypatch):
    def refused(*_, **__):
        raise OSError(30, "Read-only file system")

    monkeypatch.setattr("tempfile.TemporaryFile", refused)
    monkeypatch.setattr("memsgyro_jax.montecarlo.store.Leases", None)
    computed, rows, notes = gone_on(broken)
    assert (computed, notes) == ([], [])
    assert_wanted(rows)
    shard(broken, "left", 1).unlink()
    with pytest.raises(InputError, match="lacks 8 dies, but its folder cannot be written to"):
        gone_on(broken)


def test_a_store_is_kept_wherever_fsspec_can_write(tmp_path):
    """No leases there: each its own share. What lies there is what a local folder holds."""
    fsspec = pytest.importorskip("fsspec")
    path = place_of("memory://lot") / "dies.zarr"
    for share, blocks in ((range(2), [0, 1]), (range(2), []), (range(2, 3), [2]), (range(3), [])):
        with opened(path, LAYOUT, DIES, BLOCK, resume=True, share=share) as store:
            computed = []
            for number in store.unfinished():
                computed.append(number)
                store.write(number, rows_of(number))
        assert (computed, store.notes) == (blocks, [])
    assert_wanted(store.rows)
    assert standing_of("memory://lot").finished
    with opened(tmp_path / "dies.zarr", LAYOUT, DIES, BLOCK, resume=False) as local:
        for number in local.unfinished():
            local.write(number, rows_of(number))
    system = fsspec.filesystem("memory")
    there = {name.removeprefix("/lot/"): system.cat_file(name) for name in system.find("/lot")}
    assert there == {str(f.relative_to(tmp_path)): f.read_bytes() for f in tmp_path.rglob("*") if f.is_file()}
    with pytest.raises(InputError, match="--resume"), opened(path, LAYOUT, DIES, BLOCK, resume=False):
        pass
    discard(path)
    assert system.find("/lot") == []
    with pytest.raises(InputError, match=r"nowhere://lot.*cannot be reached"):
        standing_of("nowhere://lot")


def shard(path: Path, column: str, number: int) -> Path:
    place = path / column / "c" / str(number)
    return place / "0" if place.is_dir() else place


def flip(file: Path) -> None:
    content = bytearray(file.read_bytes())
    content[len(content) // 2] ^= 1
    file.write_bytes(content)


@pytest.mark.parametrize("harm", [flip, Path.unlink, lambda file: file.write_bytes(b"")], ids=["flip", "gone", "empty"])
@pytest.mark.parametrize("column", ["left", "right", "seal", STATUS])
def test_a_damaged_shard_is_computed_again_and_told(broken, harm, column):
    harm(shard(broken, column, 1))
    computed, rows, notes = gone_on(broken)
    assert computed == [2]
    assert_wanted(rows)
    quiet = column == STATUS and harm is Path.unlink  # as a kill just before the status leaves it
    assert notes == [] if quiet else ["Dies 32 to 39" in note for note in notes] == [True]
    assert gone_on(broken)[::2] == ([], [])


INDEX = 2 * 16 + 4  # bytes of an index of two chunks


@pytest.mark.parametrize("column", ["left", "right", "seal", STATUS])
@pytest.mark.parametrize(("place", "lost"), [(3, [0]), (-INDEX - 1, [1]), (-1, [0, 1]), (-10, [0, 1])])
def test_a_damaged_block_harms_no_other_of_its_shard(broken, column, place, lost):
    file = shard(broken, column, 0)
    content = bytearray(file.read_bytes())
    content[place] ^= 4
    file.write_bytes(content)
    computed, rows, notes = gone_on(broken)
    assert computed == lost
    assert_wanted(rows)
    assert len(notes) == len(lost)
    with xr.open_zarr(broken, consolidated=False, mask_and_scale=False) as found:
        assert_wanted(found.load())


def test_shards_in_each_others_place_are_computed_again(broken):
    left, other = shard(broken, "left", 0), shard(broken, "left", 1)
    kept = left.read_bytes()
    left.write_bytes(other.read_bytes())
    other.write_bytes(kept)
    computed, rows, _ = gone_on(broken)
    assert computed == [0, 1, 2]
    assert_wanted(rows)


def test_a_whole_shard_in_anothers_place_is_computed_again(broken):
    for column in ("left", "right", "seal", STATUS):
        shutil.copy(shard(broken, column, 0), shard(broken, column, 1))
    computed, rows, _ = gone_on(broken)
    assert computed == [2]
    assert_wanted(rows)


@pytest.mark.parametrize("seed", range(20))
def test_a_block_that_waits_for_its_shard_counts_if_it_is_sound(tmp_path, seed):
    path = tmp_path / "dies.zarr"
    with opened(path, LAYOUT, DIES, BLOCK, resume=False) as store:
        number = next(store.unfinished())
        store.write(number, rows_of(number))
        assert_wanted(store.rows, BLOCK)
    (file,) = (tmp_path / "dies.blocks").iterdir()
    generator, content = np.random.default_rng(seed), bytearray(file.read_bytes())
    place = int(generator.integers(len(content)))
    if seed % 4 == 0:
        content[place] ^= 1 << int(generator.integers(8))
    elif seed % 4 == 1:
        content = content[:place]
    elif seed % 4 == 2:
        content = content[:place] + generator.bytes(9) + content[place:]
    file.write_bytes(content)
    computed, rows, notes = gone_on(path)
    assert computed in ([1, 2], [0, 1, 2])
    assert len(notes) == (computed == [0, 1, 2])
    assert seed % 4 != 3 or computed == [1, 2]
    assert_wanted(rows)
    assert [file.name for file in tmp_path.iterdir()] == ["dies.zarr"]


def test_metadata_are_written_anew_and_told(broken):
    file = broken / "left" / "zarr.json"
    file.write_text(file.read_text().replace('"float64"', '"float32"'))
    computed, rows, notes = gone_on(broken)
    assert computed == []
    assert len(notes) == 1
    assert str(file) in notes[0]
    assert_wanted(rows)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"fingerprint": "another"}, "another configuration"),
        ({"versions": "python 3, jax 1"}, "another version .*jax 0"),
        ({"schema": "memsgyro-dies/1"}, "another version .*memsgyro-dies/1"),
        ({"block": 8}, "blocks of 8"),
        ({"fingerprint": None}, "another configuration"),
    ],
)
def test_what_is_another_computation_is_refused(broken, change, words):
    file = broken / "zarr.json"
    document = json.loads(file.read_text())
    if "versions" in change:
        layout = Layout(LAYOUT.columns, LAYOUT.coordinates, LAYOUT.attributes | change)
    else:
        layout = LAYOUT
        document["attributes"] |= change
        file.write_text(json.dumps(document))
    with pytest.raises(InputError, match=words):
        gone_on(broken, layout=layout)


def test_another_kind_of_processor_is_told(broken):
    layout = Layout(LAYOUT.columns, LAYOUT.coordinates, LAYOUT.attributes | {PROCESSOR: "another"})
    for _ in range(2):
        computed, rows, notes = gone_on(broken, layout=layout)
        assert computed == []
        assert_wanted(rows)
        assert len(notes) == 1
        assert "another kind of processor" in notes[0]
    assert gone_on(broken)[2] == []


def test_nothing_is_taken_for_a_status_that_is_none(tmp_path):
    """Seals are not asked here: someone may have written them to fit."""
    with opened(tmp_path / "dies.zarr", LAYOUT, DIES, BLOCK, resume=False) as store:
        for number in store.unfinished():
            store.write(number, rows_of(number) | ({STATUS: np.full(BLOCK, 7, np.int8)} if number == 1 else {}))
    computed, rows, notes = gone_on(tmp_path / "dies.zarr")
    assert (computed, len(notes)) == ([1], 1)
    assert_wanted(rows)


VALUES = (0, -1, 7, 10**30, 1.5, "", "x", None, True, [], {}, [[[]]], "NaN", {"name": "bytes"})


def edit(generator: np.random.Generator, text: str) -> str:
    """Metadata with one entry changed, removed, or doubled in depth."""
    document = json.loads(text)
    place = document
    while True:
        keys = list(place) if isinstance(place, dict) else list(range(len(place)))
        key = keys[generator.integers(len(keys))]
        if not isinstance(place[key], dict | list) or not place[key] or generator.random() < 0.3:
            break
        place = place[key]
    if generator.random() < 0.2:
        del place[key]
    else:
        place[key] = VALUES[generator.integers(len(VALUES))]
    return json.dumps(document)


def mutate(generator: np.random.Generator, path: Path) -> list[Path]:
    """Harms a store in one of many ways; gives the files concerned."""
    files = sorted(file for file in path.rglob("*") if file.is_file())
    one, other = (files[n] for n in generator.integers(len(files), size=2))
    content = bytearray(one.read_bytes())
    place = int(generator.integers(max(1, len(content))))
    kind = generator.integers(10)
    if kind <= 1:
        content[place] ^= 1 << int(generator.integers(8))
        one.write_bytes(content)
    elif kind == 2:
        one.write_bytes(b"")
    elif kind == 3:
        one.unlink()
    elif kind == 4:
        one.write_bytes(content[:place])
    elif kind == 5:
        one.write_bytes(other.read_bytes())
        other.write_bytes(content)
    elif kind == 6:
        one.write_bytes(other.read_bytes())
    elif kind == 7:
        one.write_bytes(content[:place] + generator.bytes(9) + content[place:])
    elif kind == 8:
        shutil.rmtree(one.parent if one.parent != path else path / "left")
    else:
        one = [file for file in files if file.name == "zarr.json"][generator.integers(5)]
        nested = generator.random() < 0.1
        one.write_text("[" * 100_000 if nested else edit(generator, one.read_text()))
    return [one, other]


def assert_mutations_are_seen(whole: Path, folder: Path, seeds: range) -> None:
    for seed in seeds:
        path = Path(shutil.copytree(whole, folder / str(seed) / "dies.zarr"))
        harmed = mutate(np.random.default_rng(seed), path)
        try:
            computed, rows, notes = gone_on(path)
        except InputError:
            continue
        assert_wanted(rows)
        # What a kill just before the status leaves is no damage.
        assert notes or not computed or any(STATUS in file.parts for file in harmed), seed
        if seed % 8 == 0:  # what is on disk now is right too
            computed, _, notes = gone_on(path)
            assert (computed, [note for note in notes if "processor" not in note]) == ([], [])
        shutil.rmtree(path.parent)


@pytest.fixture
def planned(monkeypatch):
    """The empty store's files made once: of a thousand openings they would take half the time."""
    monkeypatch.setattr(layouts, "files_of", functools.cache(lambda *given, _made=layouts.files_of: _made(*given)))
    monkeypatch.setattr(Layout, "__hash__", object.__hash__)


def test_no_mutation_gives_a_traceback_or_another_row(whole, tmp_path, planned):
    assert_mutations_are_seen(whole, tmp_path, range(200))


@pytest.mark.slow
def test_none_of_5000_mutations_gives_a_traceback_or_another_row(whole, tmp_path, planned):
    assert_mutations_are_seen(whole, tmp_path, range(200, 5200))
