"""The LLVM IR of the functions through which CPython calls a kernel. They read arguments at known field offsets in Python
objects."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from antdsl.machine_code import llvm_compiler
from antdsl.machine_code.library import make_library_text, read_llvm_file

MAX_TABLE_WORDS = 256  # maximum length of a call's table, 2 kB on the stack
MAX_JOB_PARTS = 64  # maximum number of parts of a job
RESULT_WORDS = 8  # words for results at the start of a table
PART_RESULTS_WORD = 40  # index of the first word in a pool with the results of each part of a job
MAX_TUPLE_DEPTH = 6  # maximum nesting of tuples
TYPE_FLAGS_OFFSET, TUPLE_FLAG = 168, 1 << 26  # offset of a type's flags; the flag of tuples and subclasses
REAL_KIND, INTEGER_KIND, UNSIGNED_KIND, TRUTH_KIND = range(4)  # kinds of numbers
ARRAY_ARGUMENT, TUPLE_ARGUMENT, NUMBER_ARGUMENT = range(3)
WORDS_PER_ARGUMENT = 8  # words that describe an argument
HEADER_WORDS = 16  # words before the descriptions of arguments
PYTHON_OBJECTS: Mapping[str, Any] = {
    "array.type": np.ndarray, "float": float, "f64": np.float64, "f32": np.float32, "int": int, "i64": np.int64,
    "u64": np.uint64, "bool": bool, "b8": np.bool_, "None": None, "True": True,
}  # fmt: skip
PYTHON_API_CALLS = (
    "PyObject_Vectorcall", "PyEval_SaveThread", "PyEval_RestoreThread", "PyLong_AsLongLongAndOverflow",
    "PyLong_AsUnsignedLongLong", "PyErr_Clear", "PyTuple_New", "PyTuple_SetItem", "PyFloat_FromDouble", "PyLong_FromLongLong",
    "PyLong_FromUnsignedLongLong", "PyBool_FromLong", "Py_IncRef", "Py_DecRef", "PyList_New",
    "PyList_SetItem",
)  # fmt: skip


def measure_bytes_data_offset() -> int:
    """Return the offset, in bytes, at which the data of a `bytes` object begins."""
    return object.__basicsize__ + 16  # after the length and a hash


@make_library_text
def build_llvm_text(_: llvm_compiler.Target) -> str:
    """Return the LLVM IR of the function `PyObject *direct(PyObject *description, PyObject *const *given, Py_ssize_t count)`."""
    head = object.__basicsize__
    names = (*(f"call.{name}" for name in PYTHON_API_CALLS), *PYTHON_OBJECTS)
    readers = (_render_reader(name, number) for number, name in enumerate(names))
    code_text = read_llvm_file("direct.ll") + "\n".join([*readers, ""])
    values = {"HEAD": head, "TYPE": head - 8, "DESCRIPTION": measure_bytes_data_offset(), "INSIDE": tuple.__basicsize__}
    values |= {"WORDS": MAX_TABLE_WORDS, "DEPTH": MAX_TUPLE_DEPTH}
    values |= {"AXES": head + 8, "LENGTHS": head + 16, "STEPS": head + 24, "DTYPE": head + 40, "FLAGS": head + 48}
    values |= {"STEP": 8 * WORDS_PER_ARGUMENT, "FIRST": 8 * HEADER_WORDS, "ARRAY": ARRAY_ARGUMENT, "TUPLE": TUPLE_ARGUMENT}
    values |= {"TYPE.FLAGS": TYPE_FLAGS_OFFSET, "TUPLE.FLAG": TUPLE_FLAG}
    values |= {"GIVEN": 8 * PART_RESULTS_WORD, "GIVEN.STEP": 8 * RESULT_WORDS}
    values |= {"REAL": REAL_KIND, "WHOLE": INTEGER_KIND, "UNSIGNED": UNSIGNED_KIND, "RESULTS": RESULT_WORDS}
    for name, value in values.items():
        code_text = code_text.replace(f"${name}$", str(value))
    return code_text


def _render_reader(name: str, number: int) -> str:
    """Return the LLVM IR of the function `name`, which returns entry `number` of the table of Python addresses."""
    return (
        f"define internal ptr @{name}(ptr %here) alwaysinline {{\n  %at = getelementptr ptr, ptr %here, i64 {number}\n"
        "  %found = load ptr, ptr %at\n  ret ptr %found\n}"
    )
