"""`@kernel`, `@inlined` and `@called`: Python functions that are translated to machine code."""

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

from antdsl.machine_code import codes, library, machine
from antdsl.machine_code.entries import inner_text
from antdsl.machine_code.kernels import sources
from antdsl.machine_code.kernels.calling import KernelDescription, caller, parallel_caller
from antdsl.machine_code.kernels.checks import CHECKS_ENABLED, CheckRenderer, guard_call
from antdsl.machine_code.kernels.checks.line_tables import LineTables
from antdsl.machine_code.kernels.direct.argument_text import RESULT_WORDS
from antdsl.machine_code.kernels.ir import IrFunction, verify
from antdsl.machine_code.kernels.records import rebuild_like, resolve_annotation
from antdsl.machine_code.kernels.rendering import render_functions
from antdsl.machine_code.kernels.side_by_side import write_function
from antdsl.machine_code.kernels.types import INT, LLVM_TYPE_BY_KIND, ArrayType, ScalarType
from antdsl.machine_code.kernels.units import KernelUnit, result_type
from antdsl.machine_code.kernels.values import Array, KernelItem, Number, leaves
from antdsl.machine_code.module import LlvmModule

PythonFunction = Callable[..., Any]
F = TypeVar("F", bound=PythonFunction)


@dataclass(frozen=True, slots=True, eq=False)
class KernelPart:
    """A function that kernels call. `attribute`: `alwaysinline`, or empty if LLVM decides about inlining."""

    function: FunctionType
    attribute: str = ""

    @lru_cache(maxsize=512)  # noqa: B019 - a part lives as long as its module
    def source(self) -> tuple[str, ast.FunctionDef, dict[str, Any]]:
        """Return its file, its definition with line numbers of that file, and the names of its module."""
        code = self.function.__code__
        tree = ast.parse(textwrap.dedent(inspect.getsource(self.function))).body[0]
        assert isinstance(tree, ast.FunctionDef)
        return code.co_filename, ast.increment_lineno(tree, code.co_firstlineno - 1), self.function.__globals__

    @lru_cache(maxsize=512)  # noqa: B019
    def types(self) -> dict[str, Any]:
        """Return the annotated types by parameter; `return` is the result. Parameters without an annotation are left out."""
        function = self.function
        return {
            name: () if annotation in ("None", None) else resolve_annotation(annotation, function.__globals__)
            for name, annotation in function.__annotations__.items()
        }


def _part(attribute: str) -> Callable[[F], F]:
    """Return a decorator that marks a function as a part of kernels with this attribute."""

    def decorate(function: F) -> F:
        function.part = KernelPart(function, attribute)  # type: ignore[attr-defined, arg-type]
        return function

    return decorate


inlined = _part("alwaysinline")
called = _part("")


class Kernel:
    """A function of arrays and numbers that returns numbers. It is compiled to machine code at its first call.

    Raises ValueError for an array with another type or memory layout than its annotation."""

    # `__call__` is an instance attribute, so the interpreter calls a built-in function without a Python frame.
    __slots__ = ("__call__", "__dict__", "__weakref__")
    __call__: Callable[..., Any]

    def __init__(self, function: FunctionType) -> None:
        self.part = KernelPart(function)
        self.__doc__, self.__name__, self.__module__ = function.__doc__, function.__name__, function.__module__
        self._lock = Lock()
        self._run: Callable[..., Any] | None = None
        self._apart: Callable[[], Callable[..., list[Any]] | None] | None = None
        self.__call__ = self._first_call
        library.add(self)

    def _first_call(self, *arguments: Any) -> Any:
        """Load the machine code, then call it."""
        return self.load_function()(*arguments)

    def load_function(self) -> Callable[..., Any]:
        """Return the function that calls the machine code. The code is compiled or loaded if needed. Raises
        MachineCodeUnavailable."""
        with self._lock:
            if self._run is None:
                machine.require()
                types, host = self.types(), machine.host()
                code = codes.code(self.text_key(host), lambda: self.text(host))
                self._run = self.__call__ = run = self.caller(code)
                self._apart = cache(
                    lambda: _guard(
                        parallel_caller(self.__name__, code, types, self._description(code), run), code, CHECKS_ENABLED
                    )
                )
            return self._run

    def caller(self, code: machine.LoadedCode, checked: bool = CHECKS_ENABLED) -> Callable[..., Any]:
        """Return the function that calls this kernel in the code of a text that contains it."""
        guarded_call: Callable[..., Any] = _guard(
            caller(self.__name__, code, self.types(), self._description(code)), code, checked
        )
        return guarded_call

    def _description(self, code: machine.LoadedCode) -> KernelDescription:
        return KernelDescription.read(code.constant_text(_description_name(self.__name__)))

    def parted(self) -> Callable[..., list[Any]] | None:
        """Return the function that runs the kernel in parts on a pool of workers, as `calling.parallel_caller`; None if there is
        none."""
        if self._apart is None:
            self.load_function()
        assert self._apart is not None
        return self._apart()

    def has_code(self) -> bool:
        """Return whether its machine code is available, in memory or from another run."""
        if self._run is not None:
            return True
        return codes.is_available(self.text_key(machine.host()))

    def text_key(self, target: machine.Target) -> str:
        """Return the key of its sources, or its text if the sources have no key."""
        return sources.key(self.part, self.types()) or self.text(target)

    def types(self) -> list[Any]:
        """Return the types of its annotations; for a record, the types of its fields."""
        function = self.part.function
        named = function.__code__.co_varnames[: function.__code__.co_argcount]
        return [resolve_annotation(function.__annotations__.get(name), function.__globals__) for name in named]

    def text(self, target: machine.Target = machine.PORTABLE_TARGET) -> str:
        """Return the text to compile, in LLVM's language."""
        return text_of([self], target)

    def instructions(self) -> tuple[str, KernelItem, list[IrFunction]]:
        """Return the instructions for the interpreter, without lanes.

        The result has the name of the kernel's function, its result, and all functions, callees first."""
        unit = KernelUnit(lanes=1)
        words, arrays = count(), count()
        name, result = write_function(unit, self.part, [_argument(each, words, [], arrays) for each in self.types()])
        verify(unit.functions)
        return name, result, unit.functions


def text_of(kernels: Sequence[Kernel], target: machine.Target, checked: bool = CHECKS_ENABLED) -> str:
    """Return one text of several kernels with different names, in LLVM's language."""
    unit, module, tables = KernelUnit(), LlvmModule(target), LineTables() if checked else None
    entries = [line for each in kernels for line in _entry(each, unit, module, tables)]
    verify(unit.functions)
    functions = render_functions(unit.functions, CheckRenderer() if checked else None, tables)
    return (
        "\n".join([f"; {machine.ALL_PASSES_COMMENT}", module.text(), *functions, *entries, *(tables.text() if tables else [])])
        + "\n"
    )


def _entry(kernel: Kernel, unit: KernelUnit, module: LlvmModule, tables: LineTables | None) -> tuple[str, str]:
    """Return the constant that describes a kernel, and the function that reads its arguments from a table and stores its
    results."""
    words, arrays, body = count(RESULT_WORDS), count(), list[str]()
    inputs = [_argument(each, words, body, arrays) for each in kernel.types()]
    name, result = write_function(unit, kernel.part, inputs)
    arguments = ", ".join(each.typed for item in inputs for each in leaves(item))
    results = list(leaves(result))
    if len(results) > RESULT_WORDS:
        raise TypeError(f"{kernel.__name__} gives back more than {RESULT_WORDS} numbers")
    code = kernel.part.function.__code__
    line_table = "" if tables is None else tables.begin_function(kernel.__name__, code.co_filename, code.co_firstlineno)
    call = f"call {result_type(result)} {name}({arguments})" + ("" if tables is None else tables.of(0))
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
    line = KernelDescription(tuple(each.kind for each in results), several, tuple(sorted(unit.written))).text()
    constant = f'@{_description_name(kernel.__name__)} = constant [{len(line) + 1} x i8] c"{line}\\00"'
    return constant, inner_text(module, kernel.__name__, "\n".join(body), line_table)


def _description_name(name: str) -> str:
    """Return the name of the constant that describes a kernel."""
    return f"about.{name}"


def _guard(run: Any, code: machine.LoadedCode, checked: bool) -> Any:
    """Return a call that raises KernelFault for failed checks if the build is checked, else the call itself."""
    return guard_call(run, code) if checked and run is not None else run


def kernel(function: PythonFunction) -> Kernel:
    """Return the kernel of a function with annotated arguments."""
    return Kernel(function)  # type: ignore[arg-type]


def _argument(type: Any, words: Iterator[int], body: list[str], numbers: Iterator[int]) -> KernelItem:
    """Return the item of an argument. Its numbers are read from the next `words` of the table."""

    def read(kind: str) -> Number:
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
        return rebuild_like(type, (_argument(each, words, body, numbers) for each in type))
    if isinstance(type, ScalarType):
        return read(type.kind)
    if not isinstance(type, ArrayType):
        raise TypeError("an argument of a kernel has a type of `kernels`")
    origin = next(numbers)
    place = read("ptr")
    lengths = tuple(read(INT) for _ in range(type.axes))
    steps = tuple(read(INT) for _ in range(type.axes)) if type.strided else None
    return Array(type.of, place, lengths, steps, origin)
