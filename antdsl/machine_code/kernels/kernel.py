"""`@kernel`, `@inlined` and `@called`: functions whose text becomes machine code."""

from __future__ import annotations

import ast
import inspect
import textwrap
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cache
from threading import Lock
from types import FunctionType, GenericAlias
from typing import Any

from antdsl.machine_code import codes, machine
from antdsl.machine_code.entries import entry
from antdsl.machine_code.kernels import sources
from antdsl.machine_code.kernels.calling import Told, caller, parted
from antdsl.machine_code.kernels.direct_text import RESULTS
from antdsl.machine_code.kernels.side_by_side import written
from antdsl.machine_code.kernels.types import INT, LLVM, ArrayType, Scalar
from antdsl.machine_code.kernels.units import Unit, result_type
from antdsl.machine_code.kernels.values import Array, Item, Number, leaves
from antdsl.machine_code.lanes import Module

Function = Callable[..., Any]
_ABOUT = "about"  # the constant that tells of a kernel


@dataclass(frozen=True, slots=True, eq=False)
class Part:
    """A function that kernels call, and how: `alwaysinline`, or as LLVM sees fit."""

    function: FunctionType
    attribute: str = ""

    def source(self) -> tuple[ast.FunctionDef, dict[str, Any]]:
        """Its definition, and the names of its module."""
        tree = ast.parse(textwrap.dedent(inspect.getsource(self.function))).body[0]
        assert isinstance(tree, ast.FunctionDef)
        return tree, self.function.__globals__


def _part(attribute: str) -> Callable[[Function], Function]:
    def decorate(function: Function) -> Function:
        function.part = Part(function, attribute)  # type: ignore[attr-defined, arg-type]
        return function

    return decorate


inlined = _part("alwaysinline")
called = _part("")


class Kernel:
    """A function of arrays and numbers, as machine code that is made when it is first called. Raises ValueError for an array of
    another type, or that does not lie as its annotation says; what it gives back are numbers."""

    # What is called is held by the instance, so that the interpreter goes to a built-in function and makes no frame for a call.
    __slots__ = ("__call__", "__dict__", "__weakref__")
    __call__: Callable[..., Any]

    def __init__(self, function: FunctionType) -> None:
        self.part = Part(function)
        self.__doc__, self.__name__, self.__module__ = function.__doc__, function.__name__, function.__module__
        self._lock = Lock()
        self._run: Callable[..., Any] | None = None
        self._apart: Callable[[], Callable[..., list[Any]] | None] | None = None
        self.__call__ = self._first

    def _first(self, *arguments: Any) -> Any:
        """The first call."""
        return self.made()(*arguments)

    def made(self) -> Callable[..., Any]:
        """The function that calls the machine code, which is made or loaded if it is not there yet. Raises NoMachineCode."""
        with self._lock:
            if self._run is None:
                machine.require()
                types = self._types()
                key = sources.key(self.part, types)
                host = machine.host()
                code = codes.code(self.text(host)) if key is None else codes.code(key, lambda: self.text(host))
                told = Told.read(code.told(_ABOUT))
                self._run = self.__call__ = run = caller(self.__name__, code, types, told)
                self._apart = cache(lambda: parted(self.__name__, code, types, told, run))
            return self._run

    def parted(self) -> Callable[..., list[Any]] | None:
        """The function that has its machine code run by a pool of workers, as `calling.parted` says; None where there is none."""
        if self._apart is None:
            self.made()
        assert self._apart is not None
        return self._apart()

    def kept(self) -> bool:
        """Whether its machine code is there, in memory or from another run."""
        if self._run is not None:
            return True
        key = sources.key(self.part, self._types())
        return codes.kept(self.text(machine.host()) if key is None else key)

    def _types(self) -> list[Any]:
        """What its annotations name."""
        function = self.part.function
        named = function.__code__.co_varnames[: function.__code__.co_argcount]
        return [_annotated(function.__annotations__.get(name), function.__globals__) for name in named]

    def text(self, target: machine.Target = machine.ANY) -> str:
        """What is compiled, in LLVM's language."""
        types = self._types()
        unit, lines = Unit(), [f"; {machine.WHOLE}"]
        words = iter(range(RESULTS, 100_000))
        body: list[str] = []
        numbers = iter(range(100_000))
        inputs = [_argument(each, words, body, numbers) for each in types]
        name, result = written(unit, self.part, inputs)
        arguments = ", ".join(each.typed for item in inputs for each in leaves(item))
        found = list(leaves(result))
        if len(found) > RESULTS:
            raise TypeError(f"{self.__name__} gives back more than {RESULTS} numbers")
        call = f"call {result_type(result)} {name}({arguments})"
        body.append(f"  {call}" if not found else f"  %given = {call}")
        for k, each in enumerate(found):
            value = "%given"
            if len(found) > 1:
                value = f"%given{k}"
                body.append(f"  {value} = extractvalue {result_type(result)} %given, {k}")
            stored = LLVM[each.kind]
            if stored == "i1":
                body.append(f"  %wide{k} = zext i1 {value} to i64")
                value, stored = f"%wide{k}", "i64"
            elif stored == "float":
                body.append(f"  %wide{k} = fpext float {value} to double")
                value, stored = f"%wide{k}", "double"
            body.append(f"  %to{k} = getelementptr i64, ptr %t, i64 {k}\n  store {stored} {value}, ptr %to{k}")
        module = Module(target)
        text = entry(module, self.__name__, "\n".join(body))
        told = Told(
            tuple(each.kind for each in found), isinstance(result, tuple) and bool(found), tuple(sorted(unit.written))
        ).text()
        about = f'@{_ABOUT} = constant [{len(told) + 1} x i8] c"{told}\\00"'
        lines += [about, *unit.declared.values(), module.text(), *unit.functions, text]
        return "\n".join(lines) + "\n"


def kernel(function: Function) -> Kernel:
    """A kernel of a function whose arguments have annotations."""
    return Kernel(function)  # type: ignore[arg-type]


def _annotated(annotation: Any, world: dict[str, Any]) -> Any:
    return _type(_parsed(annotation), world) if isinstance(annotation, str) else _spread(annotation)


@cache
def _parsed(text: str) -> ast.expr:
    return ast.parse(text, mode="eval").body


def _type(node: ast.expr | None, world: dict[str, Any]) -> Any:
    """What an annotation names: a Scalar, an ArrayType, or a tuple of these."""
    if isinstance(node, ast.Name):
        return _spread(world.get(node.id, tuple))
    if isinstance(node, ast.Subscript):
        inner = node.slice.elts if isinstance(node.slice, ast.Tuple) else [node.slice]
        of = [_type(each, world) for each in inner]
        base = _type(node.value, world)
        return tuple(of) if base is tuple else base[of[0]]
    raise TypeError("an argument of a kernel has a type of `kernels`")


def _spread(named: Any) -> Any:
    """What a name stands for, where that may be `tuple[..]` of others."""
    if isinstance(named, GenericAlias):
        return tuple(_spread(each) for each in named.__args__)
    return named


def _argument(type: Any, words: Iterator[int], body: list[str], numbers: Iterator[int]) -> Item:
    """The item of an argument, read from the table in these words."""

    def read(kind: str) -> Number:
        k = next(words)
        stored = "double" if kind == "float" else "i64" if kind == "i1" else kind if kind == "ptr" else LLVM[kind]
        body.append(f"  %p{k} = getelementptr i64, ptr %t, i64 {k}\n  %w{k} = load {stored}, ptr %p{k}")
        if kind == "float":
            body.append(f"  %n{k} = fptrunc double %w{k} to float")
        elif kind == "i1":
            body.append(f"  %n{k} = icmp ne i64 %w{k}, 0")
        else:
            return Number(kind, f"%w{k}")
        return Number(kind, f"%n{k}")

    if isinstance(type, tuple):
        return tuple(_argument(each, words, body, numbers) for each in type)
    if isinstance(type, Scalar):
        return read(type.kind)
    assert isinstance(type, ArrayType)
    origin = next(numbers)
    place = read("ptr").name
    lengths = tuple(read(INT) for _ in range(type.axes))
    steps = tuple(read(INT) for _ in range(type.axes)) if type.strided else None
    return Array(type.of, place, lengths, steps, origin)
