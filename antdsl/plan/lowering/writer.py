"""The state of lowering: the current block of one species, the stores on the path to it, and how reads see registers.

An own attribute reads as `snap` while no statement on the path can have written it. So nodes that depend on it are shared with
all other places. After a possible write it reads as `load`, counted by the stores before it in the text."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any, NamedTuple

from antdsl.diagnostics import Report
from antdsl.plan.builder import PlanBuilder, PlanError
from antdsl.plan.ir import Block, If, PlanNode, PlanStatement, Register, Store, ValueKind
from antdsl.plan.lowering import values
from antdsl.plan.lowering.values import VectorNodes
from antdsl.plan.traverse import required_nodes
from antdsl.program import model
from antdsl.source import Span

AXES = ("x", "y", "z")
HELD_VECTOR_TEMP = "~held"  # a vector on its way into its registers
KIND_BY_TYPE_KIND = {
    model.TypeKind.NUMBER: ValueKind.F32, model.TypeKind.BOOL: ValueKind.BOOL, model.TypeKind.STATE: ValueKind.I32,
    model.TypeKind.ITEM: ValueKind.I32,
    model.TypeKind.AGENT: ValueKind.I64,
}  # fmt: skip
NONE_BY_KIND = {model.TypeKind.ITEM: -1, model.TypeKind.AGENT: -1}


class UnsupportedConstruct(Exception):
    """A construct that passes the checks but cannot run yet. It becomes an error with a location."""

    def __init__(self, what: str, span: Span, help: str) -> None:
        super().__init__(what)
        self.what, self.span, self.help = what, span, help


class LoweringRules(NamedTuple):
    """How compound expressions become nodes: operations by name, sets, and reductions over sets. They lower their own parts, so a
    Writer receives them from outside."""

    operations: Mapping[str, Callable[[PlanWriter, model.OperationExpr], values.LoweredValue]]
    gather: Callable[[PlanWriter, model.SetExpr], values.LoweredValue]
    reduce: Callable[[PlanWriter, model.ReduceExpr], values.LoweredValue]
    pair_value: Callable[[PlanWriter, model.AttributeDecl, model.Expr], PlanNode]
    clip: Callable[[PlanWriter, model.ClipTest], PlanNode]


class PlanWriter:
    """The place where the statements of one species go. `born`: nothing is a snapshot yet, every read is a `load`."""

    def __init__(
        self, builder: PlanBuilder, program: model.Program, species: model.Species, report: Report, rules: LoweringRules
    ) -> None:
        self.b = builder
        self.rules = rules
        self.program = program
        self.species = species
        self.report = report
        self.registers: dict[str, Register] = {}
        self.born = False
        self.measures_pushes = False  # whether agents have the register `moved`
        self.begun_with: frozenset[str] = frozenset()  # attributes that the scene may give at birth
        self.snapshot = False
        self.elements: list[model.Binding] = []
        self.environment: dict[model.Binding, values.LoweredValue] = {}
        self.lets: dict[model.Binding, tuple[values.LoweredValue, tuple[model.Binding, ...]]] = {}
        self.fleeting: dict[model.Binding, tuple[values.LoweredValue, tuple[model.Binding, ...]]] = {}
        self.memories: dict[model.Binding, tuple[tuple[str, PlanNode, Span], ...]] = {}
        self.met: list[model.Binding] = []  # memories met since a `let` was begun
        self.statements: list[PlanStatement] = []
        self._written: set[str] = set()
        self._remembered: set[model.Binding] = set()
        self._stores: dict[str, int] = {}

    # --- registers ---------------------------------------------------------------------------------------------------

    def declare(
        self,
        name: str,
        kind: ValueKind,
        role: str,
        zero: float | int | bool = 0,
        of: str | None = None,
        holds: tuple[Any, ...] = (),
    ) -> None:
        """Declare a register of this species. A second declaration of the same name is an internal error."""
        known = self.registers.get(name)
        if known is None:
            self.registers[name] = Register(name, kind, role, zero, of, holds)
        elif known.kind is not kind or known.role != role:
            raise PlanError(f"register {name} is a {known.kind.value} {known.role} and a {kind.value} {role}")

    def declare_typed(self, name: str, type: model.ValueType, role: str) -> None:
        """Registers for a value of the language: three for a vector."""
        holds = (type.kind.value, *type.dim, type.of)
        if type.kind is model.TypeKind.VECTOR:
            for axis in AXES:
                self.declare(f"{name}.{axis}", ValueKind.F32, role, holds=holds)
        elif type.kind in KIND_BY_TYPE_KIND:
            of = type.of if type.kind is model.TypeKind.AGENT else None
            self.declare(name, KIND_BY_TYPE_KIND[type.kind], role, NONE_BY_KIND.get(type.kind, 0), of, holds)
        else:
            raise PlanError(f"{name} cannot be stored: it is a {type.kind.value}")

    def read(self, name: str) -> PlanNode:
        """The register as this place sees it."""
        return self._read(name, self.snapshot)

    def read_now(self, name: str) -> PlanNode:
        """Return the register's current value, even if it has a snapshot. For latches, which are all set before anything reads
        them."""
        return self._read(name, False)

    def _read(self, name: str, snapshot: bool) -> PlanNode:
        register = self.registers[name]
        version = self._stores.get(name, 0)
        if self.born:
            return self.b("load", attrs=(name, version), kind=register.kind)
        if snapshot or name not in self._written:
            if register.role == "temp":
                return self.b.zero(register.kind, register.zero)
            return self.b("snap", attrs=(name,), kind=register.kind)
        return self.b("load", attrs=(name, version), kind=register.kind)

    def read_previous(self, name: str) -> PlanNode:
        """Return the register's value before this step, at any place."""
        if self.born:
            return self.b.zero(self.registers[name].kind, self.registers[name].zero)
        return self.b("snap", attrs=(name,), kind=self.registers[name].kind)

    def read_vector(self, name: str) -> VectorNodes:
        return VectorNodes(*(self.read(f"{name}.{axis}") for axis in AXES))

    def mark_written(self, name: str) -> None:
        """Something else than a Store (a claim, a gift) changed the register."""
        self._written.add(name)
        self._stores[name] = self._stores.get(name, 0) + 1
        self.fleeting.clear()

    def begin_step(self) -> None:
        """Forget what has been written: a step begins."""
        self._written.clear()
        self._remembered.clear()
        self._stores.clear()
        self.fleeting.clear()
        self.memories.clear()

    def tell(self, e: model.Expr) -> values.LoweredValue:
        """Lower a spec's expression about a whole population; programs cannot use these."""
        raise PlanError(f"only specs can use this: {e.span.text!r}")

    # --- notes -------------------------------------------------------------------------------------------------------

    # Called as parts of the text are lowered; `NotingWriter` stores what explains a step.

    def note_transition(self, machine: str, number: int, state: model.State, t: model.Transition, fires: PlanNode) -> None:
        """A transition of a state, and whether it fires."""

    def note_choice(self, key: str, draw: PlanNode, weights: list[tuple[int, PlanNode]]) -> None:
        """A transition's choice among states: its draw and the weight of each."""

    def note_layer(self, layer: model.Layer, left: PlanNode, looked: PlanNode, holds: PlanNode, push: VectorNodes) -> None:
        """A layer: the strength left for it, whether there is any, whether its condition holds, its push."""

    def note_steering(
        self, s: model.Steer | model.FaceLine | model.Layer, site: str, push: VectorNodes, holds: PlanNode | None = None
    ) -> None:
        """A `steer` line, or a `face` line of a state or of the layers, and whether its condition holds there."""

    def note_rest(self, rest: model.RestingPush, push: VectorNodes) -> None:
        """Note the push that replaces the `steer` line of agents that have none."""

    # --- statements --------------------------------------------------------------------------------------------------

    def add(self, statement: PlanStatement) -> None:
        self.statements.append(statement)

    def store(self, name: str, value: PlanNode, span: Span | None, infinite: bool = False) -> None:
        """Set a register from here on. A store of the current value is left out."""
        kind = self.registers[name].kind
        if value.kind is not kind:
            raise PlanError(f"register {name} is a {kind.value} and cannot take a {value.kind.value}")
        if value is self.read(name):
            return
        self.add(Store(name, value, span, infinite))
        self.mark_written(name)

    def store_vector(self, name: str, value: VectorNodes, span: Span | None) -> None:
        """Set three registers as one: a component that needs the old value of another must not see the new one."""
        names = [f"{name}.{axis}" for axis in AXES]
        parts = list(value)
        if any(self._has_load(part, set(names[:place])) for place, part in enumerate(parts)):
            for axis, part in zip(AXES, parts, strict=True):
                self.declare(f"{HELD_VECTOR_TEMP}.{axis}", ValueKind.F32, "temp")
                self.store(f"{HELD_VECTOR_TEMP}.{axis}", part, span)
            parts = list(self.read_vector(HELD_VECTOR_TEMP))
        for register, part in zip(names, parts, strict=True):
            self.store(register, part, span)

    @staticmethod
    def _has_load(node: PlanNode, names: set[str]) -> bool:
        return any(n.op == "load" and n.attrs[0] in names for n in required_nodes([node]))

    def store_value(self, name: str, value: values.LoweredValue, span: Span | None, infinite: bool = False) -> None:
        """Set the registers of a value of the language."""
        if isinstance(value, VectorNodes):
            self.store_vector(name, value, span)
        elif isinstance(value, values.EntityRef):
            self.store(name, value.node, span)
        elif isinstance(value, PlanNode):
            self.store(name, value, span, infinite)
        else:
            raise PlanError(f"{name} cannot hold a {type(value).__name__}")

    def advance_memory(self, memory: model.Binding) -> None:
        """Advance a memory on this way through the step, once, and note that a `let` met it."""
        self.met.append(memory)
        if memory in self._remembered:
            return
        self._remembered.add(memory)
        for register, node, span in self.memories[memory]:
            self.store(register, node, span)

    # --- regions -----------------------------------------------------------------------------------------------------

    @contextmanager
    def block(self) -> Iterator[Callable[[], Block]]:
        """Collect statements separately; call the yielded function to get them as a Block."""
        outer, self.statements = self.statements, []
        mine = self.statements
        try:
            yield lambda: Block(tuple(mine))
        finally:
            self.statements = outer

    @contextmanager
    def region(self, condition: PlanNode, span: Span | None) -> Iterator[None]:
        """Open a region: statements inside run only where the condition holds."""
        outer = self.statements
        written, remembered = set(self._written), set(self._remembered)
        if condition is self.b.true:
            yield
            return
        self.statements = []
        try:
            yield
        finally:
            inner, self.statements = self.statements, outer
            self._remembered = remembered
            self.fleeting.clear()
            if condition is self.b.false:
                self._written = written
            elif inner:
                self.add(If(condition, Block(tuple(inner)), span))

    def alternatives(self, cases: Sequence[tuple[PlanNode, Span | None, Callable[[], None]]]) -> None:
        """Write regions of which at most one applies to an agent. Stores in one are not visible in the others."""
        entered = set(self._written)
        all_written = set(entered)
        for condition, span, write in cases:
            self._written = set(entered)
            with self.region(condition, span):
                write()
            all_written |= self._written
        self._written = all_written

    def run(self, name: str) -> PlanNode:
        """A value of the run."""
        return self.b("run", attrs=(name,))
