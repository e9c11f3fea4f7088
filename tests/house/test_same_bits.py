"""Foraging with 1 and 2 threads, chunks of 1,000 and 100,000, rows shuffled, both backends: one state hash a frame."""

from __future__ import annotations

import pytest
from foraging_shots import EXAMPLE, world
from sampling import sampled

from antdsl.runtime import Options, state_hash, step

# How rays meet a mesh and the queries about it differ by these; how a mesh is prepared does not.
OPTION_SETS = (
    Options(threads=2, chunk=1000),
    Options(threads=1, chunk=100_000, shuffle_rows=1),
    Options(threads=2, chunk=100_000, shuffle_rows=2),
)


def hashes(options: Options, frames: int, **changes: object) -> list[str]:
    under_way = world(options, **changes)  # type: ignore[arg-type]
    hash_list = [state_hash(under_way)]
    for _ in range(frames):
        step(under_way)
        hash_list.append(state_hash(under_way))
    return hash_list


CROWD = dict(count=2200, around=(70.0, 0.0, 50.0), radius=110.0)


@pytest.fixture(scope="module")
def plainly() -> list[str]:
    return hashes(Options(threads=1, chunk=1000), 6, **CROWD)


@pytest.mark.parametrize("options", sampled(OPTION_SETS, OPTION_SETS[1:]), ids=str)
def test_hashes_do_not_depend_on_threads_chunks_and_rows(options: Options, plainly: list[str]) -> None:
    assert hashes(options, 6, **CROWD) == plainly


def test_the_reference_backend_agrees() -> None:
    near = dict(count=20, around=(105.0, 0.0, 80.0), radius=25.0)
    reference_hashes = hashes(Options(backend="reference", shuffle_rows=3), 30, **near)
    assert reference_hashes == hashes(Options(threads=2), 30, **near)
    assert len(set(reference_hashes)) == 31


@pytest.mark.slow
@pytest.mark.parametrize("options", OPTION_SETS, ids=str)
def test_the_same_hashes_with_fifteen_thousand(options: Options) -> None:
    many = EXAMPLE / "many.yaml"
    assert hashes(options, 60, scene=many) == hashes(Options(threads=1, chunk=1000), 60, scene=many)


@pytest.mark.slow
def test_the_reference_backend_agrees_on_a_longer_way() -> None:
    near = dict(count=40, around=(70.0, 0.0, 50.0), radius=80.0)
    assert hashes(Options(backend="reference"), 200, **near) == hashes(Options(), 200, **near)
