"""Calls a kernel's machine code. Arguments are checked and written into a table of 64-bit words, which the code reads.

Machine code (`direct`) handles most calls. The functions of this module handle the others, and report wrong arguments, such as
arrays of another type or memory layout."""

from __future__ import annotations

import ctypes
import struct
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

from antdsl.machine_code import llvm_compiler, workers_text
from antdsl.machine_code.kernels import direct
from antdsl.machine_code.kernels.direct import ArgumentSpec
from antdsl.machine_code.kernels.direct.argument_text import INTEGER_KIND, REAL_KIND, RESULT_WORDS, TRUTH_KIND, UNSIGNED_KIND
from antdsl.machine_code.kernels.types import INT, ArrayType, ScalarType
from antdsl.machine_code.memory import get_array_address

_CTYPES_FORMATS = {"double": "d", "float": "d", "i64": "q", "u64": "Q", "i1": "q"}
_RESULT_KINDS = {"double": REAL_KIND, "float": REAL_KIND, "i64": INTEGER_KIND, "u64": UNSIGNED_KIND, "i1": INTEGER_KIND}


@dataclass(frozen=True, slots=True)
class KernelDescription:
    """The results of a kernel and the arrays that it writes to, as stored with its compiled code.

    - `result_kinds`: the kinds of its results
    - `has_several_results`: whether the kernel returns a tuple
    - `written_arrays`: the numbers of the arrays that the kernel writes to"""

    result_kinds: tuple[str, ...]
    has_several_results: bool
    written_arrays: tuple[int, ...]

    def text(self) -> str:
        """Return the description as one line of text; `from_text` reads it. The line has no quotation marks."""
        return ";".join(
            (",".join(self.result_kinds), str(int(self.has_several_results)), ",".join(map(str, self.written_arrays)))
        )

    @classmethod
    def from_text(cls, text: str) -> KernelDescription:
        """Return the description from a line that the method `text` wrote."""
        gives, several, stored = (tuple(filter(None, part.split(","))) for part in text.split(";"))
        return cls(gives, several == ("1",), tuple(map(int, stored)))


def make_caller(
    name: str, code: llvm_compiler.LoadedCode, types: Sequence[Any], description: KernelDescription
) -> Callable[..., Any]:
    """Return a Python function that calls the machine code of a kernel. `types`: the types of the kernel's annotations."""
    specs = list(_argument_specs(types, description.written_arrays))
    words = RESULT_WORDS + sum(_word_count(each) for each in specs)
    result_kinds, several = list(description.result_kinds), description.has_several_results
    plain_call = _make_python_caller(name, code.function(name), types, specs, words, result_kinds, several)
    if several and len(result_kinds) == 1:
        return plain_call
    kinds = [TRUTH_KIND if each == "i1" else _RESULT_KINDS[each] for each in result_kinds]
    return direct.make_builtin(name, code, specs, words, kinds, plain_call) or plain_call


def make_parallel_caller(
    name: str,
    code: llvm_compiler.LoadedCode,
    types: Sequence[Any],
    description: KernelDescription,
    single_call: Callable[..., Any],
) -> Callable[..., Any] | None:
    """Return a function that runs a kernel in parts on a pool of workers, or None if the kernel cannot run in parts. The function
    takes the kernel's arguments, but four others in place of the last two (begin and end of the loop). These are the begin and
    end of the complete loop, the number of parts, and the address of the pool. It returns a list with the kernel's results for
    each part. If machine code cannot read the arguments, the function calls `single_call` once, for the complete loop."""
    specs = list(_argument_specs(types, description.written_arrays))
    words = RESULT_WORDS + sum(_word_count(each) for each in specs)
    if any(not isinstance(each, ScalarType) or each.kind != INT for each in types[-2:]) or (
        description.has_several_results and len(description.result_kinds) == 1
    ):
        return None
    range_specs = [ArgumentSpec((len(types) + k,), words + k, INTEGER_KIND) for k in range(2)]
    kinds = [TRUTH_KIND if each == "i1" else _RESULT_KINDS[each] for each in description.result_kinds]

    def call_alone(*arguments: Any) -> list[Any]:
        return [single_call(*arguments[:-2])]

    run = workers_text.load_code().get_function_address("run")
    function: Callable[..., Any] | None = direct.make_builtin(name, code, [*specs, *range_specs], words, kinds, call_alone, run)
    return function


def _argument_specs(types: Sequence[Any], written_arrays: Sequence[int]) -> Iterator[ArgumentSpec]:
    """Yield the specifications of the arguments that a kernel expects, with their positions in the table. A tuple comes before
    its elements."""
    place, arrays = RESULT_WORDS, 0

    def each_of(types: Sequence[Any], path: tuple[int, ...]) -> Iterator[ArgumentSpec]:
        nonlocal place, arrays
        for index, type in enumerate(types):
            at = (*path, index)
            if isinstance(type, ArrayType):
                spec = ArgumentSpec(at, place, 0, type.element_type.dtype, type.axes, type.is_strided, arrays in written_arrays)
                arrays += 1
            elif isinstance(type, ScalarType):
                spec = ArgumentSpec(at, place, _RESULT_KINDS[type.kind])
            else:
                yield ArgumentSpec(at, count=len(type))
                yield from each_of(type, at)
                continue
            place += _word_count(spec)
            yield spec

    return each_of(types, ())


def _word_count(spec: ArgumentSpec) -> int:
    if spec.count is not None:
        return 0
    return 1 if spec.dtype is None else 1 + spec.axes * (2 if spec.is_strided else 1)


def _make_python_caller(
    name: str,
    function: Any,
    types: Sequence[Any],
    specs: list[ArgumentSpec],
    words: int,
    result_kinds: list[str],
    has_several_results: bool,
) -> Callable[..., Any]:
    """Return a function that calls a kernel, like `make_caller`, but reads the arguments in Python instead of machine code."""
    word_specs = [each for each in specs if each.count is None]
    results = struct.Struct("=" + "".join(_CTYPES_FORMATS[each] for each in result_kinds))
    truths = [k for k, each in enumerate(result_kinds) if each == "i1"]

    def call_kernel(*arguments: Any) -> Any:
        buffer = ctypes.create_string_buffer(8 * words)
        table = memoryview(buffer).cast("B")
        integers, unsigned, real = table.cast("q"), table.cast("Q"), table.cast("d")
        for each, value in zip(word_specs, list(flatten_arguments(name, types, arguments)), strict=True):
            if each.dtype is not None:
                for place, word in enumerate(_describe_array(name, each, value), each.word_index):
                    integers[place] = word
            elif each.kind == REAL_KIND:
                real[each.word_index] = value
            else:
                (integers if each.kind == INTEGER_KIND else unsigned)[each.word_index] = int(value)
        function(ctypes.addressof(buffer), 0, 0)
        if not result_kinds:
            return None
        values: tuple[Any, ...] = results.unpack_from(buffer)
        if truths:
            values = tuple(bool(value) if k in truths else value for k, value in enumerate(values))
        return values if has_several_results else values[0]

    return call_kernel


def flatten_arguments(name: str, types: Sequence[Any], arguments: Sequence[Any]) -> Iterator[Any]:
    """Yield the arguments in order, with each tuple replaced by its elements. Raises TypeError or ValueError for a wrong
    number of arguments."""
    if len(types) != len(arguments):
        raise TypeError(f"{name} takes {len(types)} arguments, not {len(arguments)}")
    for type, argument in zip(types, arguments, strict=True):
        if not isinstance(type, tuple):
            yield argument
        elif len(type) != len(argument):
            raise ValueError(f"{name} takes {len(type)} values there, not {len(argument)}")
        else:
            yield from flatten_arguments(name, type, argument)


def _describe_array(name: str, spec: ArgumentSpec, array: Any) -> tuple[int, ...]:
    """Return the words of the table that describe an array. Raises ValueError if its type or memory layout is not that of
    `spec`."""
    dtype, shape = spec.dtype, array.shape
    assert dtype is not None
    if (dtype is not array.dtype and dtype != array.dtype) or len(shape) != spec.axes:
        raise ValueError(f"{name} needs an array of {dtype} with {spec.axes} axes, not of {array.dtype} with {array.ndim}")
    if spec.is_written and not array.flags.writeable:
        raise ValueError(f"{name} writes to an array that is read-only")
    if not array.flags.aligned:
        raise ValueError(f"{name} needs an array that is aligned to its elements")
    if not spec.is_strided:
        return (get_array_address(array), *shape)
    size, (one, two) = dtype.itemsize, array.strides
    if (one % size or two % size) and array.size:
        raise ValueError(f"{name} needs strides that are multiples of the element size")
    if array.flags.c_contiguous:
        place = get_array_address(array)
    else:
        turned = array.T
        place = get_array_address(turned) if turned.flags.c_contiguous else array.__array_interface__["data"][0]
    return (place, *shape, one // size, two // size)
