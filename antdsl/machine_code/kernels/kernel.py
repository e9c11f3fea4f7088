"""`@kernel`, `@inlined` and `@kernel_helper`: Python functions that are translated to machine code."""

from __future__ import annotations

import ast
import inspect
import textwrap
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cache, lru_cache
from itertools import count
from threading import Lock
from types import FunctionType
from typing import Any, TypeVar

from antdsl.machine_code import code_cache, library, llvm_compiler
from antdsl.machine_code.entry_functions import write_inner_function
from antdsl.machine_code.kernels import source_key
from antdsl.machine_code.kernels.checks import CHECKS_ENABLED, CheckRenderer, guard_call
from antdsl.machine_code.kernels.checks.line_tables import LineTables
from antdsl.machine_code.kernels.direct.argument_text import RESULT_WORDS
from antdsl.machine_code.kernels.ir import IrFunction, verify_functions
from antdsl.machine_code.kernels.kernel_calls import KernelDescription, make_caller, make_parallel_caller
from antdsl.machine_code.kernels.kernel_unit import KernelUnit, result_type
from antdsl.machine_code.kernels.records import rebuild_like, resolve_annotation
from antdsl.machine_code.kernels.rendering import render_functions
from antdsl.machine_code.kernels.simd_loops import write_function
from antdsl.machine_code.kernels.types import INT, LLVM_TYPE_BY_KIND, ArrayType, ScalarType
from antdsl.machine_code.kernels.values import Array, KernelItem, Number, flatten_item
from antdsl.machine_code.llvm_module import LlvmModule

PythonFunction = Callable[..., Any]
DecoratedFunction = TypeVar("DecoratedFunction", bound=PythonFunction)


@dataclass(frozen=True, slots=True, eq=False)
class KernelPart:
    """A Python function that kernels can call. `attribute`: `alwaysinline`, or empty if LLVM decides about inlining."""

    function: FunctionType
    attribute: str = ""

    @lru_cache(maxsize=512)  # noqa: B019 - a part lives as long as its module
    def source(self) -> tuple[str, ast.FunctionDef, dict[str, Any]]:
        """Return the function's source file, its syntax tree with line numbers of that file, and the global names of its
        module."""
        code = self.function.__code__
        tree = ast.parse(textwrap.dedent(inspect.getsource(self.function))).body[0]
        assert isinstance(tree, ast.FunctionDef)
        return code.co_filename, ast.increment_lineno(tree, code.co_firstlineno - 1), self.function.__globals__

    @lru_cache(maxsize=512)  # noqa: B019
    def types(self) -> dict[str, Any]:
        """Return the annotated type of each parameter, by name, and the type of the result under the key `return`. Parameters
        without an annotation are left out."""
        function = self.function
        return {
            name: () if annotation in ("None", None) else resolve_annotation(annotation, function.__globals__)
            for name, annotation in function.__annotations__.items()
        }


def _make_decorator(attribute: str) -> Callable[[DecoratedFunction], DecoratedFunction]:
    """Return a decorator that makes a function callable from kernels. `attribute`: as in `KernelPart`."""

    def mark_function(function: DecoratedFunction) -> DecoratedFunction:
        function.part = KernelPart(function, attribute)  # type: ignore[attr-defined, arg-type]
        return function

    return mark_function


inlined = _make_decorator("alwaysinline")
kernel_helper = _make_decorator("")


class Kernel:
    """A function that takes arrays and numbers and returns numbers; it is compiled to machine code at its first call.

    A call raises ValueError for an array with a type or memory layout that does not match its annotation."""

    # `__call__` is an instance attribute, so the interpreter calls a built-in function without a Python frame.
    __slots__ = ("__call__", "__dict__", "__weakref__")
    __call__: Callable[..., Any]

    def __init__(self, function: FunctionType) -> None:
        self.part = KernelPart(function)
        self.__doc__, self.__name__, self.__module__ = function.__doc__, function.__name__, function.__module__
        self._lock = Lock()
        self._loaded_call: Callable[..., Any] | None = None
        self._get_parallel_call: Callable[[], Callable[..., list[Any]] | None] | None = None
        self.__call__ = self._first_call
        library.register_entry(self)

    def _first_call(self, *arguments: Any) -> Any:
        """Load the machine code at the first call, then call it."""
        return self.load_function()(*arguments)

    def load_function(self) -> Callable[..., Any]:
        """Return the function that calls the machine code. The code is compiled or loaded if needed. Raises
        MachineCodeUnavailableError."""
        with self._lock:
            if self._loaded_call is None:
                llvm_compiler.require_llvm()
                types, host = self.types(), llvm_compiler.find_host_target()
                code = code_cache.load_code(self.make_text_key(host), lambda: self.text(host))
                self._loaded_call = self.__call__ = run = self.make_caller(code)
                self._get_parallel_call = cache(
                    lambda: _add_fault_guard(
                        make_parallel_caller(self.__name__, code, types, self._read_description(code), run), code, CHECKS_ENABLED
                    )
                )
            return self._loaded_call

    def make_caller(self, code: llvm_compiler.LoadedCode, checked: bool = CHECKS_ENABLED) -> Callable[..., Any]:
        """Return a Python function that calls this kernel in the loaded `code`."""
        guarded_call: Callable[..., Any] = _add_fault_guard(
            make_caller(self.__name__, code, self.types(), self._read_description(code)), code, checked
        )
        return guarded_call

    def _read_description(self, code: llvm_compiler.LoadedCode) -> KernelDescription:
        return KernelDescription.from_text(code.read_constant_text(_description_name(self.__name__)))

    def get_parallel_call(self) -> Callable[..., list[Any]] | None:
        """Return the function that runs the kernel in parts on a pool of workers (see `kernel_calls.make_parallel_caller`).
        Return None if the kernel cannot run in parts."""
        if self._get_parallel_call is None:
            self.load_function()
        assert self._get_parallel_call is not None
        return self._get_parallel_call()

    def has_code(self) -> bool:
        """Return whether the kernel's machine code is available without compilation, in memory or stored in a file."""
        if self._loaded_call is not None:
            return True
        return code_cache.is_code_available(self.make_text_key(llvm_compiler.find_host_target()))

    def make_text_key(self, target: llvm_compiler.Target) -> str:
        """Return the key of the kernel's sources, or its LLVM IR if the sources have no key."""
        return source_key.compute_source_key(self.part, self.types()) or self.text(target)

    def types(self) -> list[Any]:
        """Return the types of the kernel's annotations. A record is given by the types of its fields."""
        function = self.part.function
        named = function.__code__.co_varnames[: function.__code__.co_argcount]
        return [resolve_annotation(function.__annotations__.get(name), function.__globals__) for name in named]

    def text(self, target: llvm_compiler.Target = llvm_compiler.PORTABLE_TARGET) -> str:
        """Return the LLVM IR to compile."""
        return render_kernels([self], target)

    def build_instructions(self) -> tuple[str, KernelItem, list[IrFunction]]:
        """Return the kernel's instructions without SIMD lanes, for the interpreter. The result is the name of the kernel's
        function, its result, and all functions, called functions first."""
        unit = KernelUnit(lanes=1)
        words, arrays = count(), count()
        name, result = write_function(unit, self.part, [_read_argument(each, words, [], arrays) for each in self.types()])
        verify_functions(unit.functions)
        return name, result, unit.functions


def render_kernels(kernels: Sequence[Kernel], target: llvm_compiler.Target, checked: bool = CHECKS_ENABLED) -> str:
    """Return the LLVM IR of several kernels with different names, as one text."""
    unit, module, tables = KernelUnit(), LlvmModule(target), LineTables() if checked else None
    entries = [line for each in kernels for line in _build_entry(each, unit, module, tables)]
    verify_functions(unit.functions)
    functions = render_functions(unit.functions, CheckRenderer() if checked else None, tables)
    return (
        "\n".join(
            [
                f"; {llvm_compiler.ALL_PASSES_MARKER}",
                module.text(),
                *functions,
                *entries,
                *(tables.list_nodes() if tables else []),
            ]
        )
        + "\n"
    )


def _build_entry(kernel: Kernel, unit: KernelUnit, module: LlvmModule, tables: LineTables | None) -> tuple[str, str]:
    """Return the LLVM IR of the constant that describes a kernel, and the LLVM IR of its entry function."""
    words, arrays, body = count(RESULT_WORDS), count(), list[str]()
    inputs = [_read_argument(each, words, body, arrays) for each in kernel.types()]
    name, result = write_function(unit, kernel.part, inputs)
    arguments = ", ".join(each.typed_name for item in inputs for each in flatten_item(item))
    results = list(flatten_item(result))
    if len(results) > RESULT_WORDS:
        raise TypeError(f"{kernel.__name__} returns more than {RESULT_WORDS} numbers")
    code = kernel.part.function.__code__
    line_table = "" if tables is None else tables.begin_function(kernel.__name__, code.co_filename, code.co_firstlineno)
    call = f"call {result_type(result)} {name}({arguments})" + ("" if tables is None else tables.format_location(0))
    body.append(f"  {call}" if not results else f"  %given = {call}")
    for k, each in enumerate(results):
        value = "%given"
        if len(results) > 1:
            value = f"%given{k}"
            body.append(f"  {value} = extractvalue {result_type(result)} %given, {k}")
        stored = LLVM_TYPE_BY_KIND[each.kind]
        if stored == "i1":
            body.append(f"  %wide{k} = zext i1 {value} to i64")
            value, stored = f"%wide{k}", "i64"
        elif stored == "float":
            body.append(f"  %wide{k} = fpext float {value} to double")
            value, stored = f"%wide{k}", "double"
        body.append(f"  %to{k} = getelementptr i64, ptr %t, i64 {k}\n  store {stored} {value}, ptr %to{k}")
    several = isinstance(result, tuple) and bool(results)
    line = KernelDescription(tuple(each.kind for each in results), several, tuple(sorted(unit.written_arrays))).text()
    constant = f'@{_description_name(kernel.__name__)} = constant [{len(line) + 1} x i8] c"{line}\\00"'
    return constant, write_inner_function(module, kernel.__name__, "\n".join(body), line_table)


def _description_name(name: str) -> str:
    """Return the name of the LLVM constant that describes the kernel `name`."""
    return f"about.{name}"


def _add_fault_guard(run: Any, code: llvm_compiler.LoadedCode, checked: bool) -> Any:
    """Return `run`, or in a checked build a function that calls `run` and raises KernelFault for failed checks."""
    return guard_call(run, code) if checked and run is not None else run


def kernel(function: PythonFunction) -> Kernel:
    """Make a kernel of a function with annotated arguments. Used as a decorator."""
    return Kernel(function)  # type: ignore[arg-type]


def _read_argument(type: Any, words: Iterator[int], body: list[str], numbers: Iterator[int]) -> KernelItem:
    """Return an argument as an item, and append the instructions that read it from the table to `body`.

    `type`: the argument's type. `words`: yields the indices of the next words in the table. `numbers`: yields the numbers of
    the next arrays."""

    def read_number(kind: str) -> Number:
        k = next(words)
        stored = "double" if kind == "float" else "i64" if kind == "i1" else kind if kind == "ptr" else LLVM_TYPE_BY_KIND[kind]
        body.append(f"  %p{k} = getelementptr i64, ptr %t, i64 {k}\n  %w{k} = load {stored}, ptr %p{k}")
        if kind == "float":
            body.append(f"  %n{k} = fptrunc double %w{k} to float")
        elif kind == "i1":
            body.append(f"  %n{k} = icmp ne i64 %w{k}, 0")
        else:
            return Number(kind, f"%w{k}")
        return Number(kind, f"%n{k}")

    if isinstance(type, tuple):
        return rebuild_like(type, (_read_argument(each, words, body, numbers) for each in type))
    if isinstance(type, ScalarType):
        return read_number(type.kind)
    if not isinstance(type, ArrayType):
        raise TypeError("annotate each argument of a kernel with a type of `kernels`")
    origin = next(numbers)
    place = read_number("ptr")
    lengths = tuple(read_number(INT) for _ in range(type.axes))
    steps = tuple(read_number(INT) for _ in range(type.axes)) if type.is_strided else None
    return Array(type.element_type, place, lengths, steps, origin)
