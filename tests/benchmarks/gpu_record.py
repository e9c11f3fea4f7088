"""What kernels are given and give, for `gpu_replay.py` to hold a graphics processor against.

`python tests/benchmarks/gpu_record.py FOLDER` steps foraging ants and leaves in a folder, for every kernel that a step calls, its
PTX, the memory that one call was given, and what lay there afterwards. A second call finds kernels in which agents do not depend
on each other, in parts of `--part` agents, last first."""

from __future__ import annotations

import argparse
import ctypes
import json
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from gpu_replay import CALLS

from antdsl.bench.cases import find_case
from antdsl.bench.measuring import wait_for_code
from antdsl.machine_code import llvm_compiler
from antdsl.machine_code.kernels import kernel_calls
from antdsl.machine_code.kernels.direct.argument_text import REAL_KIND
from antdsl.machine_code.kernels.kernel import Kernel
from antdsl.runtime import Options, bind, step

WARM, STEPS = 8, 30
TARGET = llvm_compiler.Target("nvptx64-nvidia-cuda", "sm_90", "")
RUN = """
declare i32 @llvm.nvvm.read.ptx.sreg.tid.x()
declare i32 @llvm.nvvm.read.ptx.sreg.ntid.x()
declare i32 @llvm.nvvm.read.ptx.sreg.ctaid.x()
define ptx_kernel void @run(ptr %tables, i64 %bytes, i64 %count) {{
  %thread = call i32 @llvm.nvvm.read.ptx.sreg.tid.x()
  %wide = call i32 @llvm.nvvm.read.ptx.sreg.ntid.x()
  %block = call i32 @llvm.nvvm.read.ptx.sreg.ctaid.x()
  %first = mul i32 %block, %wide
  %number = add i32 %first, %thread
  %own = zext i32 %number to i64
  %some = icmp ult i64 %own, %count
  br i1 %some, label %work, label %done
work:
  %offset = mul i64 %own, %bytes
  %table = getelementptr i8, ptr %tables, i64 %offset
  call void @{name}(ptr %table, i64 0, i64 0)
  br label %done
done:
  ret void
}}
"""


def leaves(item: Any) -> Iterator[Any]:
    """What is no tuple in an argument, or in what is given back."""
    if isinstance(item, tuple | list):
        for each in item:
            yield from leaves(each)
    else:
        yield item


class Recorder:
    """The first call of each kernel, with what it was given and what it gave."""

    def __init__(self, folder: Path, part: int) -> None:
        self.folder, self.part = folder, part
        self.told: list[dict[str, Any]] = []
        self.seen: set[str] = set()

    def call(self, kernel: Kernel, arguments: Sequence[Any]) -> Any:
        """A kernel's call, recorded if it is its first with anything to do."""
        name = f"{kernel.__module__.rsplit('.', 1)[1]}.{kernel.__name__}"
        code = kernel.part.function.__code__
        ranged = code.co_varnames[: code.co_argcount][-2:] == ("begin", "end")
        if name in self.seen or (ranged and arguments[-1] - arguments[-2] < self.part):
            return kernel.load_function()(*arguments)
        self.seen.add(name)
        pieces = pieces_of([each for each in leaves(arguments) if isinstance(each, np.ndarray)])
        old_contents = [bytes_of(each) for each in pieces]
        result = kernel.load_function()(*arguments)
        new_contents = [bytes_of(each) for each in pieces]
        split = ranged and result is None and self._alike_in_parts(kernel, arguments, pieces, old_contents, new_contents)
        try:
            text = llvm_compiler.compile_assembly(kernel.text(TARGET) + RUN.format(name=kernel.__name__), TARGET)
        except RuntimeError as problem:
            print(f"{name}: no PTX ({str(problem).splitlines()[0]})")
            return result
        (self.folder / f"{name}.ptx").write_text(text)
        words, slots = laid_out(kernel, name, arguments, pieces)
        arrays = {f"before{k}": np.frombuffer(value, np.uint8) for k, value in enumerate(old_contents)}
        arrays |= {f"after{k}": np.frombuffer(new, np.uint8) for k, new in enumerate(new_contents) if new != old_contents[k]}
        np.savez(self.folder / f"{name}.npz", words=words, **arrays)  # type: ignore[arg-type]
        gives = [word_of(value) for value in leaves(result)] if result is not None else []
        self.told.append({"name": name, "places": slots, "part": self.part if split else 0, "gives": gives})
        (self.folder / CALLS).write_text(json.dumps(self.told))
        return result

    def _alike_in_parts(
        self, kernel: Kernel, arguments: Sequence[Any], pieces: list[range], old_contents: list[bytes], new_contents: list[bytes]
    ) -> bool:
        """Whether it comes to the same if agents go in parts, last first."""
        for piece, value in zip(pieces, old_contents, strict=True):
            put_bytes(piece, value)
        begin, end = arguments[-2:]
        for at in reversed(range(begin, end, self.part)):
            kernel.load_function()(*arguments[:-2], at, min(at + self.part, end))
        alike = [bytes_of(piece) for piece in pieces] == new_contents
        for piece, value in zip(pieces, new_contents, strict=True):
            put_bytes(piece, value)
        return alike


def laid_out(
    kernel: Kernel, name: str, arguments: Sequence[Any], pieces: list[range]
) -> tuple[np.ndarray, list[tuple[int, int, int]]]:
    """The table of words that a call reads, but for addresses, and of these: the word, the piece of memory, and how far in it."""
    parameters = [each for each in kernel_calls._argument_specs(kernel._types(), ()) if each.count is None]
    words, slots = np.zeros(kernel_calls.RESULT_WORDS + sum(kernel_calls._word_count(each) for each in parameters), np.uint64), []
    for each, value in zip(parameters, leaves(arguments), strict=True):
        if each.dtype is None:
            words[each.word_index] = word_of(float(value) if each.kind == REAL_KIND else int(value))
            continue
        address, *rest = kernel_calls._describe_array(name, each, value)
        words[each.word_index + 1 : each.word_index + 1 + len(rest)] = rest
        number = next((k for k, piece in enumerate(pieces) if address in piece), None)
        if number is not None:
            slots.append((each.word_index, number, address - pieces[number].start))
    return words, slots


def word_of(value: float | int | bool) -> int:
    """A number's 64 bits."""
    return int(np.float64(value).view(np.uint64)) if isinstance(value, float) else int(value) % 2**64


def pieces_of(arrays: Sequence[np.ndarray]) -> list[range]:
    """Addresses of the memory that arrays lie in, those that share some as one."""
    bounds = sorted(np.lib.array_utils.byte_bounds(each) for each in arrays if each.size)
    merged_pieces: list[range] = []
    for begin, end in bounds:
        if merged_pieces and begin < merged_pieces[-1].stop:
            merged_pieces[-1] = range(merged_pieces[-1].start, max(end, merged_pieces[-1].stop))
        else:
            merged_pieces.append(range(begin, end))
    return merged_pieces


def bytes_of(piece: range) -> bytes:
    """What lies in memory there."""
    return ctypes.string_at(piece.start, len(piece))


def put_bytes(piece: range, value: bytes) -> None:
    """Write to memory there, if anything else lies there."""
    if bytes_of(piece) != value:
        ctypes.memmove(piece.start, value, len(value))


def record(folder: Path, case: str, agents: int, part: int) -> None:
    """Leave in a folder what the kernels of some steps were given and gave."""
    shot = find_case(case).make_shot(agents)
    shot = replace(shot, setting=replace(shot.setting, contacts="soft"))
    world = bind(shot.plan, shot.setting, Options(backend="native", threads=1))
    for _ in range(WARM):
        step(world)
    wait_for_code(world)
    folder.mkdir(parents=True, exist_ok=True)
    recorder = Recorder(folder, part)
    original_call = Kernel.__call__
    Kernel.__call__ = lambda self, *arguments: recorder.call(self, arguments)  # type: ignore[method-assign]
    try:
        for _ in range(STEPS):
            step(world)
    finally:
        Kernel.__call__ = original_call  # type: ignore[method-assign]
    print(f"{len(recorder.told)} kernels, {sum(each['part'] > 0 for each in recorder.told)} by parts")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--case", default="foraging")
    parser.add_argument("--agents", type=int, default=15_000)
    parser.add_argument("--part", type=int, default=8)
    options = parser.parse_args()
    record(options.folder, options.case, options.agents, options.part)


if __name__ == "__main__":
    main()
