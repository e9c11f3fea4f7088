"""Machine code for another processor, run under an emulator: `EmulatedCode` is called like code for this one.

A small C program is linked with an object file for aarch64 and runs under `qemu-aarch64` (Debian: `qemu-user`,
`gcc-aarch64-linux-gnu`, `libc6-dev-arm64-cross`). A call sends a kernel's table of words and copies of its arrays to the
program, and stores what the program returns. Between the copies are bytes that no kernel may change."""

from __future__ import annotations

import ctypes
import re
import shutil
import struct
import subprocess
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from antdsl.machine_code.kernels import kernel_calls
from antdsl.machine_code.kernels.direct.argument_text import RESULT_WORDS
from antdsl.machine_code.kernels.kernel import Kernel

EMULATOR, COMPILER = "qemu-aarch64", "aarch64-linux-gnu-gcc"
GAP = bytes([0xA5] * 64)  # between the copies of two arrays
_HEADER = struct.Struct("<4q")  # the number of the kernel, and of words, of pointers among them, of bytes of arrays
_HARNESS = """
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>

typedef void kernel_function(int64_t *, int64_t, int64_t);
@DECLARATIONS@
static kernel_function *const kernels[] = {@NAMES@};

static void fill(void *data, int64_t bytes) {
    if (bytes && fread(data, 1, bytes, stdin) != (size_t)bytes) exit(0);
}

int main(void) {
    for (;;) {
        int64_t head[4];
        fill(head, sizeof head);
        int64_t *table = malloc(8 * head[1]), *pointers = malloc(8 * head[2] + 8);
        char *arrays = aligned_alloc(64, (head[3] + 127) / 64 * 64);
        fill(table, 8 * head[1]);
        fill(pointers, 8 * head[2]);
        fill(arrays, head[3]);
        for (int64_t k = 0; k < head[2]; k++) table[pointers[k]] += (int64_t)arrays;
        kernels[head[0]](table, 0, 0);
        fwrite(table, 8, head[1], stdout);
        fwrite(arrays, 1, head[3], stdout);
        fflush(stdout);
        free(table), free(pointers), free(arrays);
    }
}
"""


def missing_program() -> str:
    """The name of a program that is needed and not installed; an empty string if there is none."""
    return next((name for name in (EMULATOR, COMPILER) if shutil.which(name) is None), "")


class EmulatedCode:
    """Kernels of one object file, in a process of the emulator. Use it in a `with` statement."""

    def __init__(self, kernels: Sequence[Kernel], text: str, code: bytes, folder: Path) -> None:
        self._text, self._names = text, [each.__name__ for each in kernels]
        declarations = "\n".join(f"extern kernel_function {name};" for name in self._names)
        harness = _HARNESS.replace("@DECLARATIONS@", declarations).replace("@NAMES@", ", ".join(self._names))
        (folder / "harness.c").write_text(harness)
        (folder / "kernels.o").write_bytes(code)
        program = folder / "harness"
        words = [COMPILER, "-O1", "-static", "-o", str(program), str(folder / "harness.c"), str(folder / "kernels.o"), "-lm"]
        subprocess.run(words, check=True, capture_output=True, text=True)
        self._process = subprocess.Popen([EMULATOR, str(program)], stdin=subprocess.PIPE, stdout=subprocess.PIPE)

    def __enter__(self) -> EmulatedCode:
        return self

    def __exit__(self, *_: object) -> None:
        self._process.communicate()

    def caller(self, kernel: Kernel) -> Callable[..., Any]:
        """The function that calls a kernel, by the same table of words as a call on this machine."""
        line = re.search(rf'@about\.{kernel.__name__} = constant .* c"(.*)\\00"', self._text)
        assert line is not None
        description, types = kernel_calls.KernelDescription.from_text(line[1]), kernel.types()
        specs = list(kernel_calls._argument_specs(types, description.written_arrays))
        words = RESULT_WORDS + sum(map(kernel_calls._word_count, specs))
        number = self._names.index(kernel.__name__)

        def function(table: int, _begin: int, _end: int) -> None:
            self._call(number, np.ctypeslib.as_array(ctypes.cast(table, ctypes.POINTER(ctypes.c_int64)), (words,)), specs)

        return kernel_calls._make_python_caller(
            kernel.__name__, function, types, specs, words, list(description.result_kinds), description.has_several_results
        )

    def _call(self, number: int, table: np.ndarray, specs: Sequence[Any]) -> None:
        """Run a kernel in the emulator. Change the words of results and the memory that the pointers of the table name."""
        sent, arrays, ranges = table.copy(), bytearray(GAP), list[tuple[int, int, int]]()
        pointers = np.array([each.word_index for each in specs if each.dtype is not None], np.int64)
        for each in specs:
            if each.dtype is None:
                continue
            first, last = _byte_range(table[each.word_index :], each)
            begin = int(table[each.word_index]) + first
            arrays += b"\0" * ((begin - len(arrays)) % 64)  # aligned as it is here
            ranges.append((len(arrays), begin, last - first))
            sent[each.word_index] = len(arrays) - first
            arrays += ctypes.string_at(begin, last - first) + GAP
        stdin, stdout = self._process.stdin, self._process.stdout
        assert stdin is not None and stdout is not None
        stdin.write(_HEADER.pack(number, len(sent), len(pointers), len(arrays)) + sent.tobytes() + pointers.tobytes() + arrays)
        stdin.flush()
        answer = stdout.read(8 * len(sent) + len(arrays))
        if len(answer) != 8 * len(sent) + len(arrays):
            raise RuntimeError(f"{EMULATOR} ended with {self._process.wait()} in {self._names[number]}")
        table[:RESULT_WORDS] = np.frombuffer(answer, np.int64, RESULT_WORDS)
        data = answer[8 * len(sent) :]
        end = 0
        for offset, begin, size in [*ranges, (len(arrays), 0, 0)]:
            if data[end:offset] != arrays[end:offset]:
                raise RuntimeError(f"{self._names[number]} changed memory outside its arrays")
            ctypes.memmove(begin, data[offset : offset + size], size)
            end = offset + size


def _byte_range(words: np.ndarray, spec: Any) -> tuple[int, int]:
    """The first byte of an array and the end of its bytes, from its pointer. `words` begins with the pointer."""
    shape, size = words[1 : 1 + spec.axes], spec.dtype.itemsize
    if not shape.all():
        return 0, 0
    steps = (
        words[1 + spec.axes : 1 + 2 * spec.axes] if spec.is_strided else [int(shape[k + 1 :].prod()) for k in range(spec.axes)]
    )
    reach = [int(n - 1) * int(step) * size for n, step in zip(shape, steps, strict=True)]
    return sum(min(0, each) for each in reach), sum(max(0, each) for each in reach) + size
