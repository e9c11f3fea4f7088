"""Writes the text of one function: its instructions, its blocks, and what the blocks know."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np

from antdsl.machine_code.lanes import (
    BITS,
    BOOL,
    F32,
    F64,
    FLOATS,
    I8,
    I32,
    I64,
    MANGLED,
    PTR,
    TYPES,
    WIDTH,
    Lanes,
    Module,
    literal,
)
from antdsl.machine_code.line_marks import NO_MARKS, Marks
from antdsl.machine_code.meanings import MEANINGS


class Emitter:
    """Writes one function. Blocks nest: what an inner block names is not known outside it, so `known` is a stack."""

    def __init__(self, module: Module) -> None:
        self.module = module
        self.allocas: list[str] = []
        self.entry: list[str] = []
        self.lines: list[str] = []
        self.block = "entry"
        self.known: list[dict[Any, Any]] = [{}]
        self.marks: Marks = NO_MARKS  # of code that is timed by line
        self._numbers = 0

    # --- text ----------------------------------------------------------------------------------------------------------

    def name(self, stem: str = "v") -> str:
        self._numbers += 1
        return f"%{stem}{self._numbers}"

    def op(self, text: str, kind: str, *, one: bool = False) -> Lanes:
        """One instruction and its result."""
        self.marks.before()
        name = self.name()
        self.lines.append(f"  {name} = {text}")
        value = Lanes(self, kind, name, one=one)
        self.marks.emitted(text, value)
        return value

    def do(self, text: str) -> None:
        self.marks.before()
        self.lines.append(f"  {text}")
        self.marks.emitted(text)

    def at_entry(self, text: str, kind: str) -> Lanes:
        """One instruction where the function begins; gives a single value."""
        name = self.name("e")
        self.entry.append(f"  {name} = {text}")
        return Lanes(self, kind, name, one=True)

    def slot(self, kind: str, *, one: bool = False, count: int = 0) -> str:
        """Room on the stack, for one value or for an array of so many."""
        type = kind if one else f"<{WIDTH} x {kind}>"
        name = self.name("a")
        self.allocas.append(f"  {name} = alloca {f'[{count} x {type}]' if count else type}, align 64")
        return name

    def label(self, stem: str) -> str:
        self._numbers += 1
        return f"{stem}{self._numbers}"

    def begin(self, label: str) -> None:
        self.lines.append(f"{label}:")
        self.block = label
        self.marks.block()

    def jump(self, label: str) -> None:
        self.do(f"br label %{label}")

    def branch(self, condition: Lanes, then: str, other: str) -> None:
        self.do(f"br {condition.typed}, label %{then}, label %{other}")

    @contextmanager
    def inside(self, condition: Lanes) -> Iterator[None]:
        """What is emitted within runs only where a single condition holds."""
        then, done = self.label("then"), self.label("done")
        self.branch(condition, then, done)
        self.begin(then)
        self.known.append({})
        yield
        self.known.pop()
        self.jump(done)
        self.begin(done)

    @contextmanager
    def loop(self, count: Lanes, step: int = 1) -> Iterator[Lanes]:
        """Runs for numbers from 0 to below a single i64, by `step`; gives the number."""
        head, body, done = self.label("head"), self.label("body"), self.label("done")
        self.marks.before()
        before = self.block
        number, following = self.name("i"), self.name("n")
        self.jump(head)
        self.begin(head)
        place = len(self.lines)
        self.lines.append("")
        more = self.op(f"icmp slt i64 {number}, {count.name}", BOOL, one=True)
        self.branch(more, body, done)
        self.begin(body)
        self.known.append({})
        yield Lanes(self, I64, number, one=True)
        self.known.pop()
        self.marks.before()
        self.lines.append(f"  {following} = add i64 {number}, {step}")
        self.lines[place] = f"  {number} = phi i64 [ 0, %{before} ], [ {following}, %{self.block} ]"
        self.jump(head)
        self.begin(done)

    def once(self, key: Any, make: Callable[[], Any]) -> Any:
        """A value that this block or one around it knows already, or makes now."""
        for names in reversed(self.known):
            if key in names:
                return names[key]
        value = self.known[-1][key] = make()
        return value

    def call(self, name: str, kind: str, *arguments: Lanes, one: bool = False) -> Lanes:
        """Call a function of the module or an intrinsic."""
        type = kind if one else f"<{WIDTH} x {kind}>"
        return self.op(f"call {type} @{name}({', '.join(each.typed for each in arguments)})", kind, one=one)

    def intrinsic(self, stem: str, *arguments: Lanes) -> Lanes:
        """An intrinsic function of lanes of one kind that gives the same kind."""
        first = arguments[0]
        suffix = f".{MANGLED[first.kind]}" if first.one else f".v{WIDTH}{MANGLED[first.kind]}"
        self.module.declare(f"llvm.{stem}{suffix}", first.type, [each.type for each in arguments])
        return self.call(f"llvm.{stem}{suffix}", first.kind, *arguments, one=first.one)

    def meaning(self, function: Any, *inputs: Any) -> Any:
        """What a NumPy function does to lanes."""
        return MEANINGS[function](self, *inputs) if function in MEANINGS else NotImplemented

    # --- values --------------------------------------------------------------------------------------------------------

    def constant(self, value: Any, kind: str, *, one: bool = False) -> Lanes:
        text = literal(value, kind)
        return Lanes(self, kind, text if one else f"splat ({kind} {text})", one=one, constant=True)

    def splat(self, value: Lanes) -> Lanes:
        """A single value in every lane."""
        if not value.one:
            return value
        if value.constant:
            return Lanes(self, value.kind, f"splat ({value.kind} {value.name})", constant=True)
        first = self.op(f"insertelement <{WIDTH} x {value.kind}> poison, {value.typed}, i64 0", value.kind)
        return self.op(
            f"shufflevector {first.typed}, <{WIDTH} x {value.kind}> poison, <{WIDTH} x i32> zeroinitializer", value.kind
        )

    def lanes(self, value: Any, like: Lanes) -> Lanes:
        """A value as lanes of the kind of another one; numbers of Python take its kind, as in NumPy."""
        if isinstance(value, Lanes):
            return self.splat(value)
        kind = like.kind
        if isinstance(value, np.generic):
            kind = TYPES[value.dtype]
        elif isinstance(value, float) and kind not in FLOATS:
            kind = F64
        return self.constant(value, kind)

    def paired(self, a: Any, b: Any) -> tuple[Lanes, Lanes]:
        """Two values as lanes of one kind: that which NumPy gives to what becomes of them."""
        if isinstance(a, Lanes):
            left, right = self.splat(a), self.lanes(b, a)
        else:
            right = self.splat(b)
            left = self.lanes(a, right)
        if left.kind == right.kind:
            return left, right
        kinds = {left.kind, right.kind}
        if F64 in kinds or kinds <= {F32, I32, I64} or kinds == {BOOL, F64}:
            kind = F64
        elif F32 in kinds:
            kind = F32
        else:
            kind = I64 if I64 in kinds else I32
        return self.convert(left, kind), self.convert(right, kind)

    def arithmetic(self, word: str, a: Any, b: Any) -> Lanes:
        left, right = self.paired(a, b)
        prefix = "f" if left.kind in FLOATS else ""
        return self.op(f"{prefix}{word} {left.typed}, {right.name}", left.kind)

    def multiplied(self, a: Lanes, b: Lanes) -> Lanes:
        """A product of whole numbers."""
        return self.op(f"mul {a.typed}, {b.name}", a.kind)

    def bitwise(self, word: str, a: Any, b: Any) -> Lanes:
        left, right = self.paired(a, b)
        return self.op(f"{word} {left.typed}, {right.name}", left.kind)

    def compare(self, word: str, a: Any, b: Any) -> Lanes:
        left, right = self.paired(a, b)
        if left.kind in FLOATS:
            return self.op(f"fcmp {'u' if word == 'ne' else 'o'}{word} {left.typed}, {right.name}", BOOL)
        return self.op(f"icmp {word if word in ('eq', 'ne') else 's' + word} {left.typed}, {right.name}", BOOL)

    def between(self, value: Lanes, low: Lanes, high: Lanes) -> Lanes:
        """A value cut to bounds that are numbers."""
        above = self.where(value > low, value, low)
        return self.where(above < high, above, high)

    def unordered(self, a: Lanes) -> Lanes:
        """Where a value is NaN."""
        return self.op(f"fcmp uno {a.typed}, {a.name}", BOOL)

    def where(self, condition: Any, then: Any, other: Any) -> Lanes:
        if not isinstance(then, Lanes) and not isinstance(other, Lanes):
            # as NumPy does for two numbers of Python
            kind = F64 if isinstance(then, float) or isinstance(other, float) else I64
            then, other = self.constant(then, kind), self.constant(other, kind)
        a, b = self.paired(then, other)
        return self.op(f"select {self.splat(condition).typed}, {a.typed}, {b.typed}", a.kind)

    def convert(self, value: Lanes, kind: str) -> Lanes:
        """As NumPy's `astype`; of a float to a whole number only those in its range are the same, none is undefined."""
        if value.kind == kind:
            return value
        to = kind if value.one else f"<{WIDTH} x {kind}>"
        if value.kind in FLOATS and kind in FLOATS:
            word = "fpext" if kind == F64 else "fptrunc"
        elif kind in FLOATS:
            word = "uitofp" if value.kind == BOOL else "sitofp"
        elif value.kind in FLOATS:
            suffix = MANGLED[kind], MANGLED[value.kind]
            stem = "llvm.fptosi.sat." + (".".join(suffix) if value.one else f"v{WIDTH}{suffix[0]}.v{WIDTH}{suffix[1]}")
            self.module.declare(stem, to, [value.type])
            return self.call(stem, kind, value, one=value.one)
        elif kind == BOOL:
            return self.compare("ne", value, 0)
        elif BITS[kind] < BITS[value.kind]:
            word = "trunc"
        else:
            word = "zext" if value.kind == BOOL else "sext"
        return self.op(f"{word} {value.typed} to {to}", kind, one=value.one)

    def whole(self, value: Lanes) -> Lanes:
        """A whole number of float64 below 2**31 as i32, by its bits once 1.5 * 2**52 is added: of any other some number, none is
        undefined."""
        return self.convert(self.bits(value + 6755399441055744.0, I64), I32)

    def bits(self, value: Lanes, kind: str) -> Lanes:
        """The same bits as another kind of one width."""
        return self.op(f"bitcast {value.typed} to <{WIDTH} x {kind}>", kind)

    def some(self, mask: Lanes) -> Lanes:
        """Whether a condition holds in some lane."""
        return self.op(f"icmp ne i8 {self.mask_bits(mask).name}, 0", BOOL, one=True)

    def mask_bits(self, mask: Lanes) -> Lanes:
        """A condition as bits of one number, the first lane's the lowest."""
        return self.op(f"bitcast {mask.typed} to i8", I8, one=True)

    def of_bits(self, bits: Lanes) -> Lanes:
        """A condition from the bits of one number."""
        return self.op(f"bitcast i8 {bits.name} to <{WIDTH} x i1>", BOOL)

    def one(self, text: str, kind: str) -> Lanes:
        """One instruction that gives a single value."""
        return self.op(text, kind, one=True)

    def field(self, base: str, offset: int) -> str:
        """The address so many bytes behind another."""
        return self.one(f"getelementptr i8, ptr {base}, i64 {offset}", PTR).name

    def get(self, place: str, kind: str, *, one: bool = False) -> Lanes:
        """What lies at an address on the stack: eight values or a single one."""
        type = kind if one else f"<{WIDTH} x {kind}>"
        return self.op(f"load {type}, ptr {place}", kind, one=one)

    def put(self, place: str, value: Lanes) -> None:
        self.do(f"store {value.typed}, ptr {place}")

    def greatest(self, value: Lanes) -> Lanes:
        """The greatest of eight whole numbers of 32 bits."""
        self.module.declare("llvm.vector.reduce.smax.v8i32", I32, [f"<{WIDTH} x i32>"])
        return self.one(f"call i32 @llvm.vector.reduce.smax.v8i32({value.typed})", I32)

    def permuted(self, value: Lanes, order: Lanes) -> Lanes:
        """Of each lane the value of the lane that an i32 of 0 to 7 names."""
        if value.constant:
            return value
        if value.kind == BOOL:
            return self.permuted(self.convert(value, I32), order) != 0
        if value.kind in (F32, I32) and self.module.target.avx2:
            name = "llvm.x86.avx2.permps" if value.kind == F32 else "llvm.x86.avx2.permd"
            self.module.declare(name, value.type, [value.type, f"<{WIDTH} x i32>"])
            return self.call(name, value.kind, value, order)
        place = self.slot(value.kind)
        self.put(place, value)
        return self.gather(Lanes(self, PTR, place, one=True), order, value.kind)

    def iota(self) -> Lanes:
        return Lanes(self, I64, f"<{', '.join(f'i64 {k}' for k in range(WIDTH))}>", constant=True)

    # --- memory --------------------------------------------------------------------------------------------------------

    def address(self, base: Lanes, index: Lanes, kind: str) -> Lanes:
        """Where the element of a single index lies."""
        return self.op(f"getelementptr {kind}, ptr {base.name}, i64 {index.name}", PTR, one=True)

    def load(self, base: Lanes, index: Lanes, kind: str) -> Lanes:
        """Eight elements from an index on; bytes as conditions for BOOL."""
        stored = I8 if kind == BOOL else kind
        place = self.address(base, index, stored)
        value = self.op(f"load <{WIDTH} x {stored}>, ptr {place.name}, align 1", stored)
        return self.compare("ne", value, 0) if kind == BOOL else value

    def store(self, base: Lanes, index: Lanes, value: Lanes) -> None:
        """Put eight elements from an index on; conditions as bytes."""
        if value.kind == BOOL:
            value = self.convert(value, I8)
        place = self.address(base, index, value.kind)
        self.do(f"store {self.splat(value).typed}, ptr {place.name}, align 1")

    def store_where(self, mask: Lanes, base: Lanes, index: Lanes, value: Lanes) -> None:
        """Put those of eight elements for which a condition holds. Nobody else may write to the eight meanwhile."""
        if value.kind == BOOL:
            value = self.convert(value, I8)
        place = self.address(base, index, value.kind)
        before = self.op(f"load <{WIDTH} x {value.kind}>, ptr {place.name}, align 1", value.kind)
        chosen = self.op(f"select {mask.typed}, {self.splat(value).typed}, {before.typed}", value.kind)
        self.do(f"store {chosen.typed}, ptr {place.name}, align 1")

    def fetch(self, place: str) -> None:
        """Have what lies at an address, which may be any, brought into the cache."""
        self.module.declare("llvm.prefetch.p0", "void", [PTR, "i32", "i32", "i32"])
        self.do(f"call void @llvm.prefetch.p0(ptr {place}, i32 0, i32 3, i32 1)")

    def load_one(self, base: Lanes, index: Lanes, kind: str) -> Lanes:
        place = self.address(base, index, I8 if kind == BOOL else kind)
        if kind == BOOL:
            value = self.op(f"load i8, ptr {place.name}", I8, one=True)
            return self.op(f"icmp ne i8 {value.name}, 0", BOOL, one=True)
        return self.op(f"load {kind}, ptr {place.name}", kind, one=True)

    def gather(self, base: Lanes, index: Lanes, kind: str) -> Lanes:
        """Elements of an array at indices, which must lie in it: eight single loads, which many processors do faster than their
        instruction for it."""
        stored = I8 if kind == BOOL else kind
        value = f"<{WIDTH} x {stored}> poison"
        for lane in range(WIDTH):
            at = self.convert(self.one(f"extractelement {index.typed}, i64 {lane}", index.kind), I64)
            single = self.load_one(base, at, stored)
            value = self.op(f"insertelement {value}, {single.typed}, i64 {lane}", stored).typed
        found = Lanes(self, stored, value.rpartition(" ")[2])
        return found != 0 if kind == BOOL else found


def elementwise(module: Module, name: str, kinds: tuple[str, ...], formula: Callable[..., Any]) -> str:
    """Add a function of lanes that does what a formula of NumPy does; gives its name."""

    def make() -> str:
        e = Emitter(module)
        inputs = [Lanes(e, kind, f"%x{k}") for k, kind in enumerate(kinds)]
        value = formula(*inputs)
        arguments = ", ".join(each.typed for each in inputs)
        body = "\n".join((*e.allocas, *e.entry, *e.lines))
        return f"define internal {value.type} @{name}({arguments}) noinline {{\nentry:\n{body}\n  ret {value.typed}\n}}"

    module.function(name, make)
    return name
