"""CRC-32 by products without carry is that of zlib, however long the bytes are and whatever came before them."""

from __future__ import annotations

import zlib
from collections.abc import Iterator

import numpy as np
import pytest
from compilers import need_llvmlite

from antdsl.machine_code import llvm_compiler
from antdsl.numerics import check_sums
from antdsl.numerics.check_sums import compute_crc32

LENGTHS = [*range(64, 200), *range(256, 300), 255, 256, 257, 400, 511, 512, 513, 767, 768, 769, 1000, 4095, 4096, 4097, 65_537]


@pytest.fixture(params=[1, 4], ids=["16 bytes at once", "64 bytes at once"])
def products(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> Iterator[int]:
    """The bytes of a stride."""
    need_llvmlite()
    host = llvm_compiler.find_host_target()
    if not check_sums.has_carryless_products(host) or check_sums.count_blocks_per_register(host) < request.param:
        pytest.skip("this processor has no such products without carry")
    features = host.features + (",-vpclmulqdq" if request.param == 1 else "")
    if request.param == 1:
        features = features.replace("+vpclmulqdq,", "")
    monkeypatch.setattr(llvm_compiler, "find_host_target", lambda: llvm_compiler.Target(host.triple, host.cpu, features))
    monkeypatch.setattr(check_sums, "MIN_BYTES_FOR_KERNEL", 64 * request.param)
    check_sums._build_crc_function.cache_clear()
    yield 64 * request.param
    check_sums._build_crc_function.cache_clear()


def test_crc_equals_zlib(products: int, monkeypatch: pytest.MonkeyPatch) -> None:
    data = np.random.default_rng(1).bytes(70_000)
    finished: list[int] = []
    plain = zlib.crc32
    monkeypatch.setattr(
        check_sums.zlib, "crc32", lambda part, initial_sum: finished.append(len(part)) or plain(part, initial_sum)
    )
    for length in (length for length in LENGTHS if length >= products):
        for initial_sum in (0, 1, 0xFFFFFFFF, 0xDEADBEEF):
            start = length % 17  # also where eight bytes do not begin
            assert compute_crc32(memoryview(data)[start : start + length], initial_sum) == plain(
                data[start : start + length], initial_sum
            )
            assert compute_crc32(bytes(length), initial_sum) == plain(bytes(length), initial_sum)
    assert not finished  # all went the other way


def test_crc_of_parts_continues(products: int) -> None:
    data = np.random.default_rng(2).bytes(5000)
    for cut in (0, 1, 63, 64, 65, 700, 4999):
        assert compute_crc32(data[cut:], compute_crc32(data[:cut])) == zlib.crc32(data)


def test_every_bit_changes_the_crc(products: int) -> None:
    data = bytearray(np.random.default_rng(3).bytes(300))
    sums = {compute_crc32(bytes(data))}
    for place in range(len(data)):
        for bit in range(8):
            data[place] ^= 1 << bit
            sums.add(compute_crc32(bytes(data)))
            data[place] ^= 1 << bit
    assert len(sums) == 1 + 8 * len(data)


@pytest.mark.parametrize("features", ["+avx2,-pclmul", "+avx2,+vpclmulqdq", ""])
def test_processors_without_carryless_products_use_zlib(features: str, products: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """The instruction would end the process."""
    target = llvm_compiler.find_host_target()
    monkeypatch.setattr(llvm_compiler, "find_host_target", lambda: llvm_compiler.Target(target.triple, "x86-64", features))
    check_sums._build_crc_function.cache_clear()
    assert check_sums._build_crc_function() is None and compute_crc32(b"abc" * 99) == zlib.crc32(b"abc" * 99)


def test_arm_processors_have_no_carryless_products() -> None:
    assert not check_sums.has_carryless_products(llvm_compiler.Target("aarch64-unknown-linux-gnu", "generic", "+pclmul"))
