"""The hash of rows: any order and split of the rows gives it, anything else that differs another."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from antdsl.numerics import row_hash

Columns = dict[str, NDArray[np.generic]]


def table(count: int) -> tuple[NDArray[np.int64], Columns]:
    """Columns of all sizes, an odd number of 32-bit halves among them, with values that repeat and many zeros."""
    rng = np.random.default_rng(count)
    columns: Columns = {
        "f8": rng.normal(size=count), "zero": np.zeros(count), "f4": rng.normal(size=count).astype(np.float32),
        "flag": rng.random(count) < 0.5, "i2": rng.integers(-3, 3, count).astype(np.int16), "i8": rng.integers(0, 3, count),
        "i4": rng.integers(-2, 2, count).astype(np.int32), "place": rng.normal(size=(3, count)).astype(np.float32),
        "same": np.ones(count, np.float32), "also": np.ones(count, np.float32),
    }  # fmt: skip
    return rng.permutation(count).astype(np.int64) * 7, columns


def hashed_rows(ids: np.ndarray, columns: dict[str, np.ndarray]) -> bytes:
    """What a digest takes in of columns with agents on the last axis: names, types and the hash of the rows."""
    parts = [part for column in columns.values() for part in column.reshape(-1, len(ids))] if len(ids) else []
    return row_hash.describe_columns(tuple(columns), columns.values()) + row_hash.hash_rows(ids, parts)


def by_definition(ids: NDArray[np.int64] | None, columns: list[NDArray[np.generic]]) -> bytes:
    """The hash of rows in whole numbers of Python, row after row."""
    count, mask = len(columns[0]) if ids is None else len(ids), (1 << 64) - 1
    halves: list[list[tuple[int, int]]] = [[] for _ in range(count)]
    for row in range(count):
        number = row if ids is None else int(ids[row])
        halves[row].append((number & 0xFFFFFFFF, number >> 32 & 0xFFFFFFFF))
        held: list[int] = []
        for column in columns:
            raw = np.ascontiguousarray(column[row : row + 1])
            if raw.itemsize == 8:
                bits = int(raw.view(np.int64)[0])
                halves[row].append((bits & 0xFFFFFFFF, bits >> 32 & 0xFFFFFFFF))
                continue
            kind = {1: np.int8, 2: np.int16, 4: np.int32}[raw.itemsize]
            held.append(int(raw.view(kind)[0]) & 0xFFFFFFFF)
            if len(held) == 2:
                halves[row].append((held[0], held[1]))
                held = []
        if held:
            halves[row].append((held[0], held[0]))
    sums = [0, 0]
    for row in range(count):
        for lane in range(2):
            total = 0
            for place, (a, b) in enumerate(halves[row]):
                one, two = row_hash.compute_word_keys(place)[2 * lane : 2 * lane + 2].tolist()
                total += ((a + one) & 0xFFFFFFFF) * ((b + two) & 0xFFFFFFFF)
            h = total & mask
            h = (h ^ h >> 33) * 0xFF51AFD7ED558CCD & mask
            h = (h ^ h >> 33) * 0xC4CEB9FE1A85EC53 & mask
            sums[lane] += h ^ h >> 33
    return b"".join((each & mask).to_bytes(8, "little") for each in sums)


@pytest.mark.parametrize("count", [0, 1, 2, 5, 31, 32, 33, 500])
def test_hashes_equal_the_definition(count: int) -> None:
    ids, columns = table(count)
    parts = [part for column in columns.values() for part in column.reshape(-1, count)] if count else []
    assert row_hash.hash_rows(ids, parts) == by_definition(ids, parts)
    subset = [columns["f8"], columns["f4"]]
    assert row_hash.hash_rows(None, subset) == by_definition(None, subset)


def test_hashes_do_not_depend_on_row_order_and_layout() -> None:
    ids, columns = table(16_484)
    expected_hash = hashed_rows(ids, columns)
    order = np.random.default_rng(1).permutation(len(ids))
    assert hashed_rows(ids[order], {name: array[..., order] for name, array in columns.items()}) == expected_hash
    assert hashed_rows(ids, {name: np.asfortranarray(array) for name, array in columns.items()}) == expected_hash


def test_every_change_changes_the_hash() -> None:
    ids, columns = table(9)
    hashes = {hashed_rows(ids, columns)}

    def differs(ids: NDArray[np.int64], columns: Columns) -> None:
        new_hash = hashed_rows(ids, columns)
        assert new_hash not in hashes
        hashes.add(new_hash)

    for name, array in columns.items():
        raw = np.ascontiguousarray(array).view(np.uint8).reshape(-1)
        for bit in range(8 * raw.size):  # every bit of every value; a flag has one
            if array.dtype == np.bool_ and bit % 8:
                continue
            changed = raw.copy()
            changed[bit // 8] ^= 1 << bit % 8
            differs(ids, columns | {name: changed.view(array.dtype).reshape(array.shape)})
    for one in range(len(ids)):
        changed_ids = ids.copy()
        changed_ids[one] += 1
        differs(changed_ids, columns)
    swapped = np.arange(9)
    swapped[[2, 6]] = swapped[[6, 2]]
    differs(ids[swapped], columns)  # two agents change all that they are
    for name in ("f8", "f4", "place", "i8"):
        differs(ids, columns | {name: columns[name][..., swapped]})
    differs(ids, columns | {"f4": columns["same"], "same": columns["f4"]})
    differs(ids, columns | {"place": columns["place"][[1, 0, 2]]})
    differs(ids, {"other" if name == "same" else name: array for name, array in columns.items()})
    differs(ids[:-1], {name: array[..., :-1] for name, array in columns.items()})
    differs(np.append(ids, 1000), {name: np.append(array, array[..., :1] * 0, axis=-1) for name, array in columns.items()})


def test_small_changes_change_half_of_the_bits() -> None:
    """Of 4,000 tables that count up no two agree, in neither half; each bit is set in about half of them."""
    hashes = [
        row_hash.hash_rows(np.zeros(1, np.int64), [np.array([k % 100]), np.array([k // 100], np.int32)]) for k in range(4_000)
    ]
    halves = np.frombuffer(b"".join(hashes), np.uint64).reshape(-1, 2)
    assert all(len(np.unique(half)) == 4_000 for half in halves.T)
    share = np.unpackbits(np.frombuffer(b"".join(hashes), np.uint8).reshape(-1, 16), axis=1).mean(axis=0)
    assert np.abs(share - 0.5).max() < 0.04


def test_hashes_equal_recorded_values() -> None:
    """Another version compares with what one version stored, on any processor."""
    ids, columns = np.array([3, 1], np.int64), {"x": np.array([1.5, -0.0]), "n": np.array([7, 9], np.int32)}
    assert row_hash.hash_rows(ids, list(columns.values())).hex() == "6c6528ad5946376db350e10234b09e90"
    assert row_hash.hash_rows(None, [np.array([0.0, 1.0])]).hex() == "0609ad30bccd182a2c957d93e52e48cf"


@pytest.mark.parametrize("count", [7, 1_024, 1_031, 3_000, 10_003])
def test_blocks_and_chunks_of_rows_add_up(count: int) -> None:
    ids, columns = table(count)
    parts = [part for column in columns.values() for part in column.reshape(-1, count)]
    expected = by_definition(ids, parts) if count < 2_000 else row_hash.hash_rows(ids, parts)
    halves = [row_hash.HashTable([ids[rows], *(part[rows] for part in parts)], row_hash.compute_word_keys, ids=True)
              .compute_sums(len(ids[rows]))
              for rows in (slice(0, count // 3), slice(count // 3, count))]  # fmt: skip
    added = b"".join(((one + other) % 2**64).to_bytes(8, "little") for one, other in zip(*halves, strict=True))
    assert row_hash.hash_rows(ids, parts) == expected == added
    table_hash, numbered = row_hash.RowHasher(), row_hash.RowHasher()
    for threads in (1, 2, 3, 1, 2):
        assert table_hash.hash_rows(ids, parts, threads) == expected
        assert numbered.hash_rows(None, parts[:3], threads) == row_hash.hash_rows(None, parts[:3])


def test_moved_tables_have_the_hash_of_their_rows() -> None:
    """Arrays of other places, lengths, types and steps, some the same as before with other values in them."""
    known, numbered = row_hash.RowHasher(), row_hash.RowHasher()
    for count in (70, 70, 71, 1, 5, 0, 1, 70):
        ids, columns = table(count)
        columns["place"] = np.ascontiguousarray(columns["place"].T)  # [n, 3]
        columns["wide"] = np.arange(2.0 * count).reshape(count, 2) + 0.5
        for turn in range(4):
            if turn == 1:
                columns["f8"][:] += 1.0  # type: ignore[operator]
            elif turn == 2:
                columns |= {"i4": columns["i4"].copy(), "place": columns["place"].copy(), "wide": columns["wide"][:, ::-1]}
            elif turn == 3:
                columns |= {"i4": columns["i8"], "f4": columns["place"][:, 1], "more": columns["zero"]}
            parts = [part for array in columns.values() for part in array.T.reshape(-1, count)] if count else []
            assert known.hash_rows(ids, list(columns.values())) == row_hash.hash_rows(ids, parts)
            assert numbered.hash_rows(None, [columns["f8"]]) == row_hash.hash_rows(None, [columns["f8"]])


def test_columns_of_one_row_are_contiguous() -> None:
    matrix, known = np.arange(15.0).reshape(5, 3), row_hash.RowHasher()
    for count in (1, 5, 1, 3):
        columns = [matrix[:count, 0]]
        assert known.hash_rows(np.arange(count), columns) == row_hash.hash_rows(np.arange(count), columns)
