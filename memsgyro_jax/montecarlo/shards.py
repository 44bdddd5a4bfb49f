"""Shards of zarr (`sharding_indexed`): one file that holds the chunks of many blocks and an index of them.

Written and read here and not through zarr, which takes a millisecond per chunk: of a million dies that is an hour. A
chunk is its numbers, compressed (Zstandard), and a CRC32C; one that holds nothing but the fill value is left out.
Behind the chunks come, for each, its place and length, and a CRC32C of these. Anything that reads zarr reads them.
"""

from collections import Counter
from functools import cache

import google_crc32c
import numpy as np
from jaxtyping import Bool
from numcodecs.zstd import Zstd


_CHECK = 4  # bytes of a CRC32C
_ABSENT = 2**64 - 1  # place and length of a chunk that was left out


def packed(values: np.ndarray, block: int, count: int, fill: float) -> bytes | None:
    """The shard of `count` chunks of `block` rows each; rows beyond `values` are `fill`. None if all of it is."""
    empty, parts = _empty(block, values.shape[1:], values.dtype, fill).tobytes(), []
    index, end = np.full((count, 2), _ABSENT, "<u8"), 0
    for number in range(-(-len(values) // block)):
        chunk = values[number * block : (number + 1) * block]
        content = np.ascontiguousarray(chunk).tobytes()
        content += empty[len(content) :]
        if content != empty:
            parts.append(_checked(_zstd().encode(content)))
            index[number] = end, len(parts[-1])
            end += len(parts[-1])
    return b"".join([*parts, _checked(index.tobytes())]) if parts else None


def unpacked(
    content: bytes | None, numbers: range, block: int, count: int, like: np.ndarray, fill: float
) -> tuple[np.ndarray, Bool[np.ndarray, " rows"]]:
    """Rows of the chunks `numbers` of a shard, with the type and further sizes of `like`, and which could be read."""
    rows = np.empty((len(numbers), block, *like.shape[1:]), like.dtype)
    rows[:] = fill
    whole = np.ones(len(numbers), bool)
    index = None if content is None else _index(content, count)
    if index is None:
        whole[:] = content is None
    else:
        for place, number in enumerate(numbers):
            begin, length = int(index[number, 0]), int(index[number, 1])
            if begin != _ABSENT:
                found = _chunk(content or b"", begin, length, rows[place].nbytes)
                whole[place] = found is not None
                if found is not None:
                    rows[place] = np.frombuffer(found, like.dtype).reshape(rows[place].shape)
    return rows.reshape(-1, *like.shape[1:]), np.repeat(whole, block)


def tallied(content: bytes | None, block: int, count: int, fill: int) -> Counter[int]:
    """How often each value stands in a shard of whole numbers of a byte; what cannot be read counts as `fill`.

    Most chunks of statuses are alike: each kind of them is unpacked once.
    """
    index = None if content is None else _index(content, count)
    if content is None or index is None:
        return Counter({fill: block * count})
    kinds = Counter(None if begin == _ABSENT else content[begin : begin + length] for begin, length in index.tolist())
    found: Counter[int] = Counter()
    for kind, times in kinds.items():
        values = None if kind is None else _chunk(kind, 0, len(kind), block)
        rows = Counter({fill: block} if values is None else np.frombuffer(values, "i1").tolist())
        found.update({value: times * many for value, many in rows.items()})
    return found


def holds(content: bytes, count: int) -> Bool[np.ndarray, " count"]:
    """Which chunks a shard has; none where its index cannot be read."""
    index = _index(content, count)
    return np.zeros(count, bool) if index is None else index[:, 0] != _ABSENT


def _index(content: bytes, count: int) -> np.ndarray | None:
    found = _unchecked(content[-(16 * count + _CHECK) :])
    return np.frombuffer(found, "<u8").reshape(count, 2) if found is not None and len(found) == 16 * count else None


def _chunk(content: bytes, begin: int, length: int, size: int) -> bytes | None:
    checked = _unchecked(content[begin : begin + length])
    if checked is None:
        return None
    try:
        found = _zstd().decode(checked)
    except (RuntimeError, ValueError):
        return None
    return found if len(found) == size else None


def _checked(content: bytes) -> bytes:
    return content + google_crc32c.value(content).to_bytes(_CHECK, "little")


def _unchecked(content: bytes) -> bytes | None:
    body = content[:-_CHECK]
    return body if len(content) > _CHECK and _checked(body) == content else None


@cache
def _zstd() -> Zstd:
    return Zstd(level=0)


def _empty(block: int, sizes: tuple[int, ...], dtype: np.dtype, fill: float) -> np.ndarray:
    return np.full((block, *sizes), fill, dtype)
