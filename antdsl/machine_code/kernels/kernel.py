"""`@kernel`, `@inlined` and `@called`: functions whose text becomes machine code."""

from __future__ import annotations

import ast
import ctypes
import inspect
import struct
import textwrap
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from threading import Lock
from types import FunctionType, GenericAlias
from typing import Any
from weakref import ref

from antdsl.machine_code import codes, machine
from antdsl.machine_code.entries import entry
from antdsl.machine_code.kernels.side_by_side import written
from antdsl.machine_code.kernels.types import INT, LLVM, ArrayType, Scalar
from antdsl.machine_code.kernels.units import Unit, result_type
from antdsl.machine_code.kernels.values import Array, Item, Number, leaves
from antdsl.machine_code.lanes import Module
from antdsl.machine_code.memory import address

Function = Callable[..., Any]
_RESULTS = 8  # words before the arguments, for what is given back
_FORMATS = {"double": "d", "float": "d", "i64": "q", "u64": "Q", "i1": "q"}


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

    def __init__(self, function: FunctionType) -> None:
        self.part = Part(function)
        self.__doc__, self.__name__, self.__module__ = function.__doc__, function.__name__, function.__module__
        self._lock = Lock()
        self._run: Callable[..., Any] | None = None

    def __call__(self, *arguments: Any) -> Any:
        run = self._run or self.made()
        return run(*arguments)

    def made(self) -> Callable[..., Any]:
        """The function that calls the machine code, which is made or loaded if it is not there yet."""
        with self._lock:
            if self._run is None:
                text, types, result, stored = self._text(machine.host())
                self._run = _caller(self.__name__, codes.code(text), types, result, stored)
            return self._run

    def text(self, target: machine.Target = machine.ANY) -> str:
        """What is compiled, in LLVM's language."""
        text, _, _, _ = self._text(target)
        return text

    def _text(self, target: machine.Target) -> tuple[str, list[Any], Any, set[int]]:
        definition, world = self.part.source()
        types = [_type(each.annotation, world) for each in definition.args.args]
        unit, lines = Unit(), [f"; {machine.WHOLE}"]
        words = iter(range(_RESULTS, 100_000))
        body: list[str] = []
        numbers = iter(range(100_000))
        inputs = [_argument(each, words, body, numbers) for each in types]
        name, result = written(unit, self.part, inputs)
        arguments = ", ".join(each.typed for item in inputs for each in leaves(item))
        found = list(leaves(result))
        if len(found) > _RESULTS:
            raise TypeError(f"{self.__name__} gives back more than {_RESULTS} numbers")
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
        lines += [*unit.declared.values(), module.text(), *unit.functions, text]
        return "\n".join(lines) + "\n", types, result, unit.written


def kernel(function: Function) -> Kernel:
    """A kernel of a function whose arguments have annotations."""
    return Kernel(function)  # type: ignore[arg-type]


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
    return tuple(_spread(each) for each in named.__args__) if isinstance(named, GenericAlias) else named


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


def _format(type: Any) -> str:
    if isinstance(type, tuple):
        return "".join(_format(each) for each in type)
    if isinstance(type, Scalar):
        return _FORMATS[type.kind]
    assert isinstance(type, ArrayType)
    return "q" + "q" * type.axes * (2 if type.strided else 1)


def _caller(name: str, code: machine.Code, types: list[Any], result: Item, stored: set[int]) -> Callable[..., Any]:
    """Calls the code: arguments are checked and laid into a table, whose first words have what is given back."""
    layout = struct.Struct(f"={8 * _RESULTS}x" + "".join(_format(each) for each in types))
    given = struct.Struct("=" + "".join(_FORMATS[each.kind] for each in leaves(result)))
    truths = [each.kind == "i1" for each in leaves(result)]
    function = code.function(name)
    numbers = iter(range(100_000))
    lay = [_layer(each, numbers, stored, name) for each in types]
    count = len(types)
    free: list[tuple[Any, int]] = []  # tables that no call is using

    def run(*arguments: Any) -> Any:
        if len(arguments) != count:
            raise TypeError(f"{name} takes {count} arguments, not {len(arguments)}")
        words: list[Any] = []
        for put, argument in zip(lay, arguments, strict=True):
            put(words, argument)
        try:
            table, place = free.pop()
        except IndexError:
            table = ctypes.create_string_buffer(layout.size)
            place = ctypes.addressof(table)
        layout.pack_into(table, 0, *words)
        function(place, 0, 0)
        found = given.unpack_from(table)
        free.append((table, place))
        if not truths:
            return None
        values = tuple(bool(value) if truth else value for value, truth in zip(found, truths, strict=True))
        return values if isinstance(result, tuple) else values[0]

    return run


def _layer(type: Any, numbers: Iterator[int], stored: set[int], name: str) -> Callable[[list[Any], Any], None]:
    """Puts an argument's words into a list."""
    if isinstance(type, tuple):
        parts = [_layer(each, numbers, stored, name) for each in type]

        def several(words: list[Any], argument: Any) -> None:
            for put, each in zip(parts, argument, strict=True):
                put(words, each)

        return several
    if isinstance(type, Scalar):
        cast: Callable[[Any], Any] = float if type.kind in ("double", "float") else int
        return lambda words, argument: words.append(cast(argument))
    dtype, axes, written_to, is_strided = type.of.dtype, type.axes, next(numbers) in stored, type.strided
    size = dtype.itemsize
    last: tuple[Any, tuple[int, ...]] = (lambda: None, ())  # the array of the call before, most often that of this one too

    def described(array: Any) -> tuple[int, ...]:
        if dtype != array.dtype or array.ndim != axes:
            raise ValueError(f"{name} wants an array of {dtype} with {axes} axes, not of {array.dtype} with {array.ndim}")
        if written_to and not array.flags.writeable:
            raise ValueError(f"{name} writes to an array that is read-only")
        if not is_strided:
            return (address(array), *array.shape)
        if array.size and any(step % size for step in array.strides):
            raise ValueError(f"{name} wants whole elements from one index to the next")
        return (array.__array_interface__["data"][0], *array.shape, *(step // size for step in array.strides))

    def put(words: list[Any], array: Any) -> None:
        nonlocal last
        known, found = last
        if known() is not array:
            found = described(array)
            last = (ref(array), found)
        words.extend(found)

    return put
