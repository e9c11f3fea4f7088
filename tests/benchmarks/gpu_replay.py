"""Kernels on a graphics processor: what they give there, held against what `gpu_record.py` has left, byte for byte.

`python tests/benchmarks/gpu_replay.py FOLDER` needs NumPy and NVIDIA's driver alone: it loads the PTX of each kernel, calls it on
the first card and counts the bytes that differ. Kernels in which agents do not depend on each other go by a thread for so many
agents each, all others by one thread. Times are those of code that was written for eight agents in a register, and no more than
a first look."""

from __future__ import annotations

import argparse
import ctypes
import json
from pathlib import Path
from typing import Any

import numpy as np

CALLS = "calls.json"
STACK = 1 << 16  # bytes of a thread there
BLOCK = 64  # threads


class Card:
    """The first card, by NVIDIA's driver."""

    def __init__(self) -> None:
        self.driver = ctypes.CDLL("libcuda.so.1")
        self.do("cuInit", 0)
        device, context = ctypes.c_int(), ctypes.c_void_p()
        self.do("cuDeviceGet", ctypes.byref(device), 0)
        name = ctypes.create_string_buffer(100)
        self.do("cuDeviceGetName", name, 100, device)
        self.name = name.value.decode()
        self.do("cuDevicePrimaryCtxRetain", ctypes.byref(context), device)
        self.do("cuCtxSetCurrent", context)
        self.do("cuCtxSetLimit", 0, ctypes.c_size_t(STACK))

    def do(self, name: str, *arguments: Any) -> None:
        """Call a function of the driver. Raises RuntimeError with its number if it fails."""
        failed = getattr(self.driver, name)(*arguments)
        if failed:
            raise RuntimeError(f"{name}: error {failed} of the driver")

    def put(self, array: np.ndarray) -> int:
        """An array's copy there: its address."""
        place = ctypes.c_uint64()
        self.do("cuMemAlloc_v2", ctypes.byref(place), ctypes.c_size_t(max(array.nbytes, 1) + 4096))
        if array.nbytes:
            self.do("cuMemcpyHtoD_v2", place, ctypes.c_void_p(array.ctypes.data), ctypes.c_size_t(array.nbytes))
        return place.value

    def get(self, place: int, array: np.ndarray) -> np.ndarray:
        """What lies there, as an array like another."""
        contents = np.empty_like(array)
        if array.nbytes:
            self.do(
                "cuMemcpyDtoH_v2", ctypes.c_void_p(contents.ctypes.data), ctypes.c_uint64(place), ctypes.c_size_t(array.nbytes)
            )
        return contents

    def function(self, ptx: bytes) -> ctypes.c_void_p:
        """The function `run` of a text in PTX, which the driver assembles."""
        module, kernel = ctypes.c_void_p(), ctypes.c_void_p()
        log = ctypes.create_string_buffer(8192)
        options = (ctypes.c_int * 2)(5, 6)  # where the log of errors goes, and its size
        values = (ctypes.c_void_p * 2)(ctypes.cast(log, ctypes.c_void_p), 8192)
        failed = self.driver.cuModuleLoadDataEx(ctypes.byref(module), ptx, 2, options, values)
        if failed:
            raise RuntimeError(f"error {failed}: {log.value.decode()[:400]}")
        self.do("cuModuleGetFunction", ctypes.byref(kernel), module, b"run")
        return kernel

    def run(self, function: ctypes.c_void_p, tables: int, words: int, count: int) -> float:
        """Milliseconds of a call for so many tables, a thread each."""
        start, end, time = ctypes.c_void_p(), ctypes.c_void_p(), ctypes.c_float()
        for event in (start, end):
            self.do("cuEventCreate", ctypes.byref(event), 0)
        values = (ctypes.c_uint64(tables), ctypes.c_uint64(8 * words), ctypes.c_uint64(count))
        pointers = (ctypes.c_void_p * 3)(*(ctypes.addressof(each) for each in values))
        block = min(BLOCK, count)
        self.do("cuEventRecord", start, None)
        self.do("cuLaunchKernel", function, -(-count // block), 1, 1, block, 1, 1, 0, None, pointers, None)
        self.do("cuEventRecord", end, None)
        self.do("cuEventSynchronize", end)
        self.do("cuEventElapsedTime", ctypes.byref(time), start, end)
        return time.value


def replay(folder: Path) -> None:
    """Run what was recorded on a card, and tell what differs."""
    card = Card()
    print(f"{card.name}\n| kernel | threads | ms | bytes compared | that differ |\n|---|---|---|---|---|")
    for call in json.loads((folder / CALLS).read_text()):
        part = call["part"]
        arrays = dict(np.load(folder / f"{call['name']}.npz", allow_pickle=False))
        try:
            function = card.function((folder / f"{call['name']}.ptx").read_bytes() + b"\0")
        except RuntimeError as problem:
            print(f"| {call['name']} | not assembled: {problem} |", flush=True)
            continue
        words = arrays.pop("words")
        begin, end = int(words[-2]), int(words[-1])
        starts = range(begin, end, part) if part else [begin]
        tables = np.tile(words, (len(starts), 1))
        if part:
            tables[:, -2], tables[:, -1] = starts, [min(at + part, end) for at in starts]
        times = []
        for _ in range(2):  # the first call brings the code there
            addresses = {name: card.put(array) for name, array in arrays.items() if name.startswith("before")}
            for word, number, offset in call["places"]:
                tables[:, word] = addresses[f"before{number}"] + offset
            at = card.put(tables)
            try:
                times.append(card.run(function, at, len(words), len(starts)))
            except RuntimeError as problem:
                print(f"| {call['name']} | failed: {problem} |", flush=True)
                return
        compared = differ = 0
        for name, place in addresses.items():
            new_name = name.replace("before", "after")
            expected = arrays[new_name if new_name in arrays else name]
            contents = card.get(place, expected)
            compared, differ = compared + len(contents), differ + int((contents != expected).sum())
        results = card.get(at, tables)[0]
        compared += len(call["gives"])
        differ += sum(int(results[k]) != value for k, value in enumerate(call["gives"]))
        print(f"| {call['name']} | {len(starts)} | {min(times):.3f} | {compared:,} | {differ} |", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    replay(parser.parse_args().folder)


if __name__ == "__main__":
    main()
