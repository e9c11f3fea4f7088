"""Draws the source of random kernels: every kind of statement and expression that kernels have, with types that fit.

No turn of an `simd_range` loop reads what another one writes. Indices are within their axis and no divisor is 0, unless a kernel
is `daring`."""

from __future__ import annotations

from random import Random

OUTPUTS = ("F64", "F32", "I64", "U64", "BOOL", "I32", "I16", "U8")
KINDS = ("F64", "F32", "I64", "U64", "BOOL")
RECORDS = {f"{a}and{b}": (a, b) for a in KINDS for b in KINDS}  # records of two fields, `one` and `other`
IMPORTS = """import math
from typing import NamedTuple

import numpy as np

from antdsl.machine_code.kernels import (
    BOOL, F32, F64, I16, I32, I64, U8, U64, Array1, Array2, Array3, Strided2, float_to_bits, bits_to_float, kernel_helper,
    prefetch, simd_range, inlined, kernel, load_consecutive, round_to_int, store3, allocate_scratch, load3,
)
"""
CLASSES = [f"class {name}(NamedTuple):\n    one: {a}\n    other: {b}" for name, (a, b) in RECORDS.items()]
PARAMETERS = ", ".join([
    *(f"in_{name}: Array1[{name}]" for name in OUTPUTS), "rows: Array2[F64]", "rows32: Array2[F32]", "strided: Strided2[F64]",
    "cube: Array3[F64]", "table: Array1[F64]", "table32: Array1[F32]", "small: Array1[I64]", "ahead: Array1[F64]",
    "order: Array1[I64]", *(f"out_{name}: Array1[{name}]" for name in OUTPUTS), "out_rows: Array2[F64]", "x: F64", "y: F32",
    "w: I64", "v: U64", "q: BOOL", "begin: I64", "end: I64",
])  # fmt: skip
CONSTANTS = {
    "F64": ("0.1", "0.5", "-1.5", "3.0", "1e300", "1e-300", "2.0", "-0.0", "9007199254740993.0"),
    "F32": ("0.5", "2.0", "-1.5", "3", "np.float32(0.1)", "np.float32(1e30)", "np.float32(1e-40)", "0.0"),
    "I64": ("1", "2", "-3", "7", "9007199254740993", "9223372036854775807", "255", "-1", "0"),
    "U64": ("1", "3", "18446744073709551615", "9223372036854775808", "255", "0"),
    "BOOL": ("True", "False"),
}
START = {"F64": "np.float64({})", "F32": "np.float32({})", "I64": "np.int64({})", "U64": "np.uint64({})", "BOOL": "bool({})"}
LOADS = {
    "F64": ("in_F64[{at}]", "rows[{at}, {part}]", "strided[{at}, {part}]", "table[{name} & 63]", "ahead[{i} + {part}]",
            "cube[{at}, {half}, {name} & 1]"),
    "F32": ("in_F32[{at}]", "rows32[{at}, {part}]", "table32[{name} & 63]"),
    "I64": ("in_I64[{at}]", "in_I32[{at}]", "in_I16[{at}]", "in_U8[{at}]", "{i}"),
    "U64": ("in_U64[{at}]",),
    "BOOL": ("in_BOOL[{at}]",),
}  # fmt: skip
COMPARED = ("<", "<=", ">", ">=", "==", "!=")


class Source:
    """One function while it is drawn. `scope` has the names of each kind that may be read, `own` those that may be changed."""

    def __init__(self, draw: Random, name: str, daring: bool, arrays: bool) -> None:
        self.draw, self.name, self.daring, self.arrays = draw, name, daring, arrays
        self.scope: dict[str, list[str]] = {kind: [] for kind in KINDS}
        self.own: dict[str, list[str]] = {kind: [] for kind in KINDS}
        self.lines: list[str] = []
        self.depth = 1
        self.at = ""  # the number of the turn, in a loop over rows
        self.lanes = False
        self.loops = 0
        self.numbers = 0
        self.helpers: list[tuple[str, list[str], list[str]]] = []
        self.outputs: dict[str, str] = {}

    def put(self, line: str) -> None:
        self.lines.append("    " * self.depth + line)

    def new(self, stem: str) -> str:
        self.numbers += 1
        return f"{stem}{self.numbers}"

    def chance(self, part: float) -> bool:
        return self.draw.random() < part

    def variable(self, kind: str, value: str) -> str:
        """A variable with a value, which may be changed."""
        name = self.new(kind.lower() + "_")
        self.put(f"{name} = {value}")
        self.scope[kind].append(name)
        self.own[kind].append(name)
        return name

    # --- expressions ---------------------------------------------------------------------------------------------------

    def index(self, depth: int) -> str:
        """A row of the arrays."""
        if self.daring and self.chance(0.15):
            return f"({self.of('I64', depth)} & 31) - 1"
        pick = self.draw.random()
        if pick < 0.6 or depth <= 0:
            return self.at
        return f"order[{self.at}]" if pick < 0.85 else f"{self.name_of('I64')} % in_F64.size"

    def small(self, depth: int, mask: int) -> str:
        return f"({self.of('I64', depth - 1) if depth > 1 else self.name_of('I64')} & {mask})"

    def name_of(self, kind: str) -> str:
        """A number without a load."""
        if names := self.scope[kind]:
            own = self.own[kind]
            return self.draw.choice(own if own and self.chance(0.5) else names)
        others = [name for other in KINDS for name in self.scope[other]]
        return START[kind].format(self.draw.choice(others) if others else "in_F64.size" if self.arrays else "1.0")

    def leaf(self, kind: str) -> str:
        """A number that no text has."""
        if not (self.at and self.arrays and self.chance(0.6)):
            return self.name_of(kind)
        text = self.draw.choice(LOADS[kind])
        at = self.at if "{at}" not in text else self.index(1)
        return text.format(at=at, i=self.at, part=self.draw.randrange(3), half=self.draw.randrange(2), name=self.name_of("I64"))

    def of(self, kind: str, depth: int) -> str:
        """An expression of a kind that is no constant."""
        if depth <= 0:
            return self.leaf(kind)
        pick = self.draw.random()
        if pick < 0.2:
            return self.leaf(kind)
        if pick < 0.27:
            return f"({self.of(kind, depth - 1)} if {self.of('BOOL', depth - 1)} else {self.any(kind, depth - 1)})"
        if pick < 0.34 and kind != "BOOL":
            word = self.draw.choice(("min", "max"))
            third = f", {self.any(kind, depth - 1)}" if self.chance(0.2) else ""
            return f"{word}({self.of(kind, depth - 1)}, {self.any(kind, depth - 1)}{third})"
        if pick < 0.38 and self.helpers:
            fitting = [each for each in self.helpers if each[2] == [kind]]
            if fitting:
                return self.call(self.draw.choice(fitting), depth - 1)
        text: str = getattr(self, f"_{kind.lower()}")(depth - 1)
        return text

    def any(self, kind: str, depth: int) -> str:
        """An expression of a kind, or a constant."""
        return self.draw.choice(CONSTANTS[kind]) if self.chance(0.3) else self.of(kind, depth)

    def call(self, helper: tuple[str, list[str], list[str]], depth: int) -> str:
        name, takes, _ = helper
        passed = [self.record(kind, depth) if kind in RECORDS else self.of(kind, depth) for kind in takes]
        return f"{name}({', '.join(['table', *passed])})"

    def record(self, name: str, depth: int) -> str:
        """A record of a class, built of its fields in their order or by name."""
        one, other = (self.any(kind, depth) for kind in RECORDS[name])
        return self.draw.choice((f"{name}({one}, {other})", f"{name}({one}, other={other})", f"{name}(other={other}, one={one})"))

    def _float(self, kind: str, depth: int) -> str:
        pick, a = self.draw.random(), self.of(kind, depth)
        if pick < 0.5:
            return f"({a} {self.draw.choice('+-*/')} {self.any(kind, depth)})"
        if pick < 0.6:
            return f"(-{a})"
        word = self.draw.choice(("np.sqrt", "np.floor", "np.ceil", "np.rint", "abs", "math.sqrt"))
        return f"{word}({a})" if pick < 0.75 else ""

    def _f64(self, depth: int) -> str:
        text = self._float("F64", depth)
        options = (
            "np.float64({f})", "np.float64({i})", "float({u})", "bits_to_float({i})", "({d} * {i})", "({d} + {b})", "float({b})",
            "({i} / {j})",
        )  # fmt: skip
        return text or self.filled(self.draw.choice(options), depth)

    def _f32(self, depth: int) -> str:
        text = self._float("F32", depth)
        return text or self.filled(
            self.draw.choice(("np.float32({d})", "np.float32({i})", "({f} * {b})", "np.float32({u})")), depth
        )

    def filled(self, text: str, depth: int) -> str:
        letters = {"d": "F64", "f": "F32", "i": "I64", "j": "I64", "u": "U64", "b": "BOOL", "c": "BOOL"}
        return text.format(**{each: self.of(kind, depth) for each, kind in letters.items() if f"{{{each}}}" in text})

    def _divisor(self, kind: str, depth: int) -> str:
        if self.daring and self.chance(0.3):
            return f"({self.of(kind, depth)} & 7)"
        return f"({self.of(kind, depth)} | 1)" if self.chance(0.7) else self.draw.choice(("3", "7", "64", "1"))

    def _integer(self, kind: str, depth: int) -> str:
        pick, a = self.draw.random(), self.of(kind, depth)
        if pick < 0.4:
            return f"({a} {self.draw.choice('+-*&|^')} {self.any(kind, depth)})"
        if pick < 0.55:
            return f"({a} {self.draw.choice(('//', '%'))} {self._divisor(kind, depth)})"
        if pick < 0.65:
            count = self.draw.choice((str(self.draw.randrange(64)), self.of(kind, depth)))
            return f"({a} {self.draw.choice(('<<', '>>'))} {count})"
        return f"(~{a})" if pick < 0.7 else ""

    def _i64(self, depth: int) -> str:
        options = (
            "int({d})", "np.int64({f})", "np.int64({u})", "np.int32({i})", "np.uint32({i})", "int({b})",
            "round_to_int(np.float64(np.int32({i})) * 0.37)", "({i} + {b})",
            "abs({i})", "(-{i})", "math.floor({d})", "float_to_bits(float({i}))", "np.int64({d})",
        )  # fmt: skip
        return self._integer("I64", depth) or self.filled(self.draw.choice(options), depth)

    def _u64(self, depth: int) -> str:
        options = ("np.uint64({i})", "np.uint64({d})", "np.uint64({f})", "np.uint64({b})")
        return self._integer("U64", depth) or self.filled(self.draw.choice(options), depth)

    def _bool(self, depth: int) -> str:
        pick, kind = self.draw.random(), self.draw.choice(("F64", "F32", "I64", "U64"))
        compared = f"({self.of(kind, depth)} {self.draw.choice(COMPARED)} {self.any(kind, depth)})"
        if pick < 0.45:
            return compared
        if pick < 0.52:
            return f"({self.any(kind, depth)} < {self.of(kind, depth)} <= {self.any(kind, depth)})"
        options = (
            "({b} and {c})", "({b} or {c})", "(not {b})", "({b} & {c})", "({b} ^ {c})", "np.isnan({d})", "np.isfinite({f})",
            "({i} < {d})", "bool({i})", "bool({d})", "math.isnan({f})",
        )  # fmt: skip
        return self.filled(self.draw.choice(options), depth)

    # --- statements ----------------------------------------------------------------------------------------------------

    def block(self, count: int, levels: int) -> None:
        """Statements one level deeper, of which `levels` levels may follow. What is named in it stays there."""
        saved = {kind: list(names) for kind, names in self.scope.items()}, {kind: list(names) for kind, names in self.own.items()}
        self.depth += 1
        previous = len(self.lines)
        for _ in range(count):
            self.statement(levels)
        if len(self.lines) == previous:
            self.put("pass")
        self.depth -= 1
        self.scope, self.own = saved

    def statement(self, levels: int) -> None:
        options = [self.assign, self.assign, self.assign, self.either, self.records]
        if levels > 0:
            options += [self.condition, self.condition, self.loop]
        if self.loops and self.depth > 2:
            options.append(self.leave)
        if self.at and self.arrays:
            options += [self.store, self.store, self.rows]
        if self.helpers:
            options.append(self.several)
        chosen = self.draw.choice(options)
        if chosen in (self.condition, self.loop):
            chosen(levels - 1)  # type: ignore[call-arg]
        else:
            chosen()

    def assign(self) -> None:
        kinds = [kind for kind in KINDS if self.own[kind]]
        kind = self.draw.choice(kinds)
        name = self.draw.choice(self.own[kind])
        if self.chance(0.3) and kind != "BOOL":
            self.put(f"{name} {self.draw.choice('+-*')}= {self.any(kind, 2)}")
        elif self.chance(0.1) and len(self.own[kind]) > 1:
            other = self.draw.choice(self.own[kind])
            self.put(f"{name}, {other} = {other}, {self.of(kind, 1)}" if other != name else "pass")
        elif self.chance(0.1):
            pair = self.new("pair")
            self.put(f"{pair} = ({self.of(kind, 1)}, {self.of(kind, 1)})")
            self.put(f"{name} = {pair}[{self.draw.randrange(2)}]")
        else:
            self.put(f"{name} = {self.of(kind, self.draw.randint(1, 3))}")

    def either(self) -> None:
        """A variable that both branches of a condition give its first value."""
        kind = self.draw.choice(KINDS)
        name = self.new("either")
        self.put(f"if {self.of('BOOL', 2)}:")
        self.put(f"    {name} = {self.of(kind, 1)}")
        self.put("else:")
        self.put(f"    {name} = {self.of(kind, 1)}")
        self.scope[kind].append(name)
        self.own[kind].append(name)

    def records(self) -> None:
        """A variable that is a record: it may be replaced, in part or by another one, in a branch."""
        kind, name = self.draw.choice(list(RECORDS)), self.new("record")
        one, other = RECORDS[kind]
        self.put(f"{name} = {self.record(kind, 1)}")
        if self.chance(0.5):
            self.put(f"if {self.of('BOOL', 1)}:")
            changed = f"{name}._replace(other={self.any(other, 1)})"
            self.put(f"    {name} = {self.draw.choice((changed, self.record(kind, 1)))}")
        if self.chance(0.3):
            self.put(f"{name} = {self.record(kind, 1)} if {self.of('BOOL', 1)} else {name}")
        self.scope[one] += [f"{name}.one", f"{name}[0]"]
        self.scope[other].append(f"{name}.other")

    def several(self) -> None:
        fitting = [each for each in self.helpers if len(each[2]) > 1]
        if fitting:
            helper = self.draw.choice(fitting)
            names = [self.draw.choice(self.own[kind]) if self.own[kind] else "_" for kind in helper[2]]
            if len(set(names)) == len(names):
                self.put(f"{', '.join(names)} = {self.call(helper, 1)}")

    def condition(self, levels: int) -> None:
        self.put(f"if {self.of('BOOL', 2)}:")
        self.block(self.draw.randint(1, 2), levels)
        if self.chance(0.3):
            self.put(f"elif {self.of('BOOL', 1)}:")
            self.block(1, levels)
        if self.chance(0.5):
            self.put("else:")
            self.block(self.draw.randint(1, 2), levels)

    def leave(self) -> None:
        self.put(f"if {self.of('BOOL', 2)}:")
        self.put(f"    {self.draw.choice(('break', 'continue'))}" if self.loops > 0 else "    continue")

    def loop(self, levels: int) -> None:
        number, pick = self.new("k"), self.draw.random()
        loops, self.loops = self.loops, self.loops + 1
        end = self.draw.choice((self.small(1, 7), str(self.draw.randint(1, 6))))
        if pick < 0.25:
            self.put(f"{number} = 0")
            self.put(f"while {number} < {end} and {self.of('BOOL', 2)}:")
            self.put(f"    {number} += 1")
        elif pick < 0.6:
            begin = self.draw.choice(("0, ", "", self.small(1, 3) + ", "))
            self.put(f"for {number} in range({begin}{end}):")
        elif pick < 0.75:
            self.put(f"for {number} in range({self.small(1, 7)}, {self.draw.choice(('0', '-1'))}, -{self.draw.randint(1, 2)}):")
        elif pick < 0.9 or not self.arrays:
            self.put(f"for {number} in ({self.of('I64', 1)}, {self.of('I64', 1)}):")
        else:
            self.put(f"for {number} in small:")
        self.scope["I64"].append(number)
        self.block(self.draw.randint(1, 2), levels)
        self.scope["I64"].remove(number)
        self.loops = loops

    def output(self, name: str) -> str:
        """The row of an array that this turn writes to: always the same one, or two turns might write to it."""
        if name not in self.outputs:
            self.outputs[name] = self.draw.choice((self.at, self.at, f"order[{self.at}]"))
        return self.outputs[name]

    def store(self) -> None:
        name = self.draw.choice(OUTPUTS)
        kind = name if name in KINDS else "I64"
        place = f"out_{name}[{self.output(name)}]"
        if self.chance(0.2) and kind != "BOOL":
            self.put(f"{place} {self.draw.choice('+-*')}= {self.any(kind, 2)}")
        elif self.chance(0.1) and name in ("I32", "F32"):
            self.put(f"{place} = {self.of('F64', 2)}")
        else:
            self.put(f"{place} = {self.of(kind, self.draw.randint(1, 3))}")

    def keep(self) -> None:
        """Store the variables at the end of a turn: all that was done to them is seen."""
        for kind in KINDS:
            arrays = [name for name in OUTPUTS if (name if name in KINDS else "I64") == kind]
            for name, place in zip(self.draw.sample(self.own[kind], min(len(self.own[kind]), len(arrays))), arrays, strict=False):
                self.put(f"out_{place}[{self.output(place)}] = {name}")
        if self.own["F64"] and self.chance(0.4):
            names = [self.draw.choice(self.own["F64"]) for _ in range(3)]
            self.put(f"store3(out_rows, {self.output('rows')}, ({', '.join(names)}))")

    def rows(self) -> None:
        """Several elements at once."""
        pick = self.draw.random()
        if pick < 0.4:
            names = [self.new("part") for _ in range(3)]
            of, kind = self.draw.choice((("rows", "F64"), ("rows32", "F32")))
            self.put(f"{', '.join(names)} = load3({of}, {self.index(1)})")
            self.scope[kind] += names
        elif pick < 0.7:
            self.put(f"store3(out_rows, {self.output('rows')}, ({', '.join(self.of('F64', 1) for _ in range(3))}))")
        elif pick < 0.9:
            of, kind = self.draw.choice((("table", "F64"), ("table32", "F32")))
            names = [self.new("part") for _ in range(4)]
            self.put(f"{', '.join(names)} = load_consecutive({of}, {self.small(1, 15)} * 4, 4)")
            self.scope[kind] += names
        else:
            self.put(f"prefetch(in_F64, {self.of('I64', 1)})")

    def variables(self, count: int) -> None:
        for kind in self.draw.sample(KINDS, count):
            self.variable(kind, self.of(kind, self.draw.randrange(2)))


def helper(
    draw: Random, name: str, daring: bool, known: list[tuple[str, list[str], list[str]]]
) -> tuple[str, tuple[str, list[str], list[str]]]:
    """The source of a function that kernels call, and what it takes and gives."""
    takes = [draw.choice(KINDS) for _ in range(draw.randint(1, 3))]
    gives = [draw.choice(KINDS) for _ in range(draw.choice((1, 1, 2)))]
    source = Source(draw, name, daring, arrays=False)
    source.helpers = known
    if draw.random() < 0.3:
        takes.append(draw.choice(list(RECORDS)))
    parameters = [source.new("p") for _ in takes]
    for parameter, kind in zip(parameters, takes, strict=True):
        if kind in RECORDS:
            one, other = RECORDS[kind]
            source.scope[one].append(f"{parameter}.one")
            source.scope[other].append(f"{parameter}.other")
        else:
            source.scope[kind].append(parameter)
    is_record = len(gives) == 2 and draw.random() < 0.5
    source.variables(3)

    def returned() -> str:
        if is_record:
            return f"return {source.record('and'.join(gives), 1)}"
        return f"return {', '.join(source.of(kind, 1) for kind in gives)}"

    for _ in range(draw.randint(0, 2)):
        source.statement(1)
    if draw.random() < 0.7:
        source.put(f"if {source.of('BOOL', 2)}:")
        source.put(f"    {returned()}")
    if draw.random() < 0.4:
        source.put(f"for k in range({source.small(1, 7)}):")
        source.put(f"    if {source.of('BOOL', 1)}:")
        source.put(f"        {returned()}")
    source.put(returned())
    head = f"@{draw.choice(('inlined', 'kernel_helper'))}\ndef {name}({', '.join(['table', *parameters])}):\n"
    return head + "\n".join(source.lines), (name, takes, gives)


def kernel_of(draw: Random, name: str, daring: bool) -> list[str]:
    """The sources of a kernel and of the functions that it calls."""
    source = Source(draw, name, daring, arrays=True)
    helpers: list[str] = []
    for k in range(draw.randint(0, 2)):
        text, known = helper(draw, f"{name}_{k}", daring, list(source.helpers))
        helpers.append(text)
        source.helpers.append(known)
    lanes = draw.random() < 0.6
    source.put(f'"""{"simd_range" if lanes else "one by one"}"""')
    for kind, parameter in zip(KINDS, "xywvq", strict=True):
        source.scope[kind].append(parameter)
    source.variables(3)
    if not lanes:
        if source.chance(0.2):
            source.put(f"out_F64[:] = {source.of('F64', 1)}")
        if source.chance(0.3):
            source.put("room = allocate_scratch(4, F64)")
            source.put("for slot in range(4):")
            source.put(f"    room[slot] = {source.of('F64', 1)}")
            source.scope["F64"] += [f"room[{k}]" for k in range(4)] + [f"room[{source.small(1, 3)}]"]
    outer, previous = source.own, {kind: list(names) for kind, names in source.own.items()}
    source.own = {kind: [] for kind in KINDS} if lanes else {kind: list(names) for kind, names in outer.items()}
    source.at, source.lanes = "i", lanes
    again = draw.random() < 0.15
    if again:
        source.put("for again in range(2):")
        source.depth += 1
    source.put(f"for i in {'simd_range' if lanes else 'range'}(begin, end):")
    source.depth += 1
    source.variables(3)
    if lanes:
        source.loops = 0
    for _ in range(draw.randint(1, 3)):
        source.statement(draw.choice((1, 1, 2)))
    source.keep()
    if not lanes and source.chance(0.2):
        source.put(f"if {source.of('BOOL', 1)}:")
        source.put(f"    {source.draw.choice(('break', 'continue'))}")
    source.depth -= 2 if again else 1
    source.at, source.own = "", outer
    scope = {kind: [each for each in outer[kind] if each in previous[kind]] for kind in KINDS}
    source.scope = scope
    returned_kinds = [kind for kind in KINDS if scope[kind]]
    if returned_kinds and source.chance(0.7):
        source.put(f"return {', '.join(source.draw.choice(scope[kind]) for kind in returned_kinds)}")
    head = f"@kernel\ndef {name}({PARAMETERS}):\n"
    return [*helpers, head + "\n".join(source.lines)]


def module_of(draw: Random, count: int, daring: bool) -> str:
    """The source of a module with so many kernels."""
    parts = [part for k in range(count) for part in kernel_of(draw, f"k{k}", daring)]
    return "\n\n\n".join([IMPORTS, *CLASSES, *parts]) + "\n"
