"""The state of lowering one species: the current block, the stores on the path to the current position, and how registers are
read.

An attribute of the agent is read by `snap`, its value at the start of the step, until a statement on the path may have written
it. Nodes that depend on a `snap` can be shared between all positions. After that, it is read by `load`. A `load` contains the
number of stores before it in the text."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any, NamedTuple

from antdsl.diagnostics import Report
from antdsl.plan.builder import PlanBuilder, PlanError
from antdsl.plan.ir import Block, If, PlanNode, PlanStatement, Register, Store, ValueKind
from antdsl.plan.lowering import values
from antdsl.plan.lowering.values import VectorNodes
from antdsl.plan.traverse import collect_required_nodes
from antdsl.program import model
from antdsl.source import Span

AXES = ("x", "y", "z")
STORED_VECTOR_TEMP = "~held"  # holds the new components while the registers change
KIND_BY_TYPE_KIND = {
    model.TypeKind.NUMBER: ValueKind.F32, model.TypeKind.BOOL: ValueKind.BOOL, model.TypeKind.STATE: ValueKind.I32,
    model.TypeKind.ITEM: ValueKind.I32,
    model.TypeKind.AGENT: ValueKind.I64,
}  # fmt: skip
NONE_BY_KIND = {model.TypeKind.ITEM: -1, model.TypeKind.AGENT: -1}


class UnsupportedConstruct(Exception):
    """Error for a construct that passes the checks but cannot run yet. It is reported with its source location."""

    def __init__(self, construct: str, span: Span, help: str) -> None:
        super().__init__(construct)
        self.construct, self.span, self.help = construct, span, help


class BodyProportions(NamedTuple):
    """Proportions of bodies that stand upright. Without a scene, these are the proportions of a person.

    `size_per_height`: length divided by height. `radius_per_size`: half of the width, divided by the length."""

    size_per_height: float = 0.5 / 1.75
    radius_per_size: float = 0.42


class LoweringRules(NamedTuple):
    """The functions that lower compound expressions. `operation_rules`: the functions for operations, by the operation's name.

    The functions call the PlanWriter. To avoid circular imports, the PlanWriter receives them as an argument."""

    operation_rules: Mapping[str, Callable[[PlanWriter, model.OperationExpr], values.LoweredValue]]
    lower_set: Callable[[PlanWriter, model.SetExpr], values.LoweredValue]
    lower_reduction: Callable[[PlanWriter, model.ReduceExpr], values.LoweredValue]
    read_pair_value: Callable[[PlanWriter, model.AttributeDecl, model.Expr], PlanNode]
    lower_clip_test: Callable[[PlanWriter, model.ClipTest], PlanNode]
    locate_point: Callable[[PlanWriter, values.LoweredValue, model.Expr], tuple[PlanNode, values.VectorNodes]]


class PlanWriter:
    """Writer that collects the statements and registers of one species' plan.

    `is_birth`: whether the block for birth is being written. In this block, every read of a register is a `load`."""

    def __init__(
        self, builder: PlanBuilder, program: model.Program, species: model.Species, report: Report, rules: LoweringRules
    ) -> None:
        self.b = builder
        self.rules = rules
        self.program = program
        self.species = species
        self.report = report
        self.registers: dict[str, Register] = {}
        self.is_birth = False
        self.has_moved_register = False  # whether agents have the register `moved`
        self.period: tuple[float, float, float] | None = None  # widths (mm) of a periodic world; 0 along axes that do not wrap
        self.proportions = BodyProportions()
        self.scene_attributes: frozenset[str] = frozenset()  # attributes that the scene may set at birth
        self.is_snapshot = False
        self.set_elements: list[model.Binding] = []
        self.environment: dict[model.Binding, values.LoweredValue] = {}
        self.snapshot_lets: dict[model.Binding, tuple[values.LoweredValue, tuple[model.Binding, ...]]] = {}
        self.current_lets: dict[model.Binding, tuple[values.LoweredValue, tuple[model.Binding, ...]]] = {}
        self.memory_updates: dict[model.Binding, tuple[tuple[str, PlanNode, Span], ...]] = {}
        self.used_memories: list[model.Binding] = []  # memories that the current `let` uses
        self.statements: list[PlanStatement] = []
        self._written: set[str] = set()
        self._advanced_memories: set[model.Binding] = set()
        self._store_counts: dict[str, int] = {}

    # --- registers ---------------------------------------------------------------------------------------------------

    def declare_register(
        self,
        name: str,
        kind: ValueKind,
        role: str,
        initial_value: float | int | bool = 0,
        id_species: str | None = None,
        language_type: tuple[Any, ...] = (),
    ) -> None:
        """Declare a register of this species. Raises an internal error if it is already declared with another kind or role."""
        known = self.registers.get(name)
        if known is None:
            self.registers[name] = Register(name, kind, role, initial_value, id_species, language_type)
        elif known.kind is not kind or known.role != role:
            raise PlanError(f"register {name} is a {known.kind.value} {known.role} and a {kind.value} {role}")

    def declare_typed(self, name: str, type: model.ValueType, role: str) -> None:
        """Declare the registers for a value of the language: three for a vector."""
        holds = (type.kind.value, *type.dimension, type.referent)
        if type.kind is model.TypeKind.VECTOR:
            for axis in AXES:
                self.declare_register(f"{name}.{axis}", ValueKind.F32, role, language_type=holds)
        elif type.kind in KIND_BY_TYPE_KIND:
            of = type.referent if type.kind is model.TypeKind.AGENT else None
            self.declare_register(name, KIND_BY_TYPE_KIND[type.kind], role, NONE_BY_KIND.get(type.kind, 0), of, holds)
        else:
            raise PlanError(f"{name} cannot be stored: it is a {type.kind.value}")

    def read_at_step_start(self, name: str) -> PlanNode:
        """Return the node that reads a register at the current position. It is a `snap`, or a `load` if the register may have
        been written before."""
        return self._read_register(name, self.is_snapshot)

    def read_current(self, name: str) -> PlanNode:
        """Return the node of a register's value after all stores so far, even inside a snapshot.

        Latches are read with this method, because they are set before any other code reads them."""
        return self._read_register(name, False)

    def _read_register(self, name: str, snapshot: bool) -> PlanNode:
        register = self.registers[name]
        version = self._store_counts.get(name, 0)
        if self.is_birth:
            return self.b("load", attrs=(name, version), kind=register.kind)
        if snapshot or name not in self._written:
            if register.role == "temp":
                return self.b.add_constant(register.kind, register.initial_value)
            return self.b("snap", attrs=(name,), kind=register.kind)
        return self.b("load", attrs=(name, version), kind=register.kind)

    def read_previous(self, name: str) -> PlanNode:
        """Return a node for the value that a register had when the step began. Writes in the step do not change it."""
        if self.is_birth:
            return self.b.add_constant(self.registers[name].kind, self.registers[name].initial_value)
        return self.b("snap", attrs=(name,), kind=self.registers[name].kind)

    def read_vector(self, name: str) -> VectorNodes:
        """Return the nodes of the three registers of a vector, read at the current position."""
        return VectorNodes(*(self.read_at_step_start(f"{name}.{axis}") for axis in AXES))

    def mark_written(self, name: str) -> None:
        """Record that a statement other than a Store changes a register, for example a claim or a gift."""
        self._written.add(name)
        self._store_counts[name] = self._store_counts.get(name, 0) + 1
        self.current_lets.clear()

    def begin_step(self) -> None:
        """Forget which registers have been written, because a new step begins."""
        self._written.clear()
        self._advanced_memories.clear()
        self._store_counts.clear()
        self.current_lets.clear()
        self.memory_updates.clear()

    def lower_spec_expression(self, e: model.Expr) -> values.LoweredValue:
        """Lower an expression that only specs may contain. In a program, it is an error."""
        raise PlanError(f"only a spec can contain this expression: {e.span.text!r}")

    # --- notes -------------------------------------------------------------------------------------------------------

    # Called during lowering. `NotingWriter` overrides these to record notes for `explain`.

    def note_transition(
        self, machine: str, number: int, state: model.State, transition: model.Transition, is_taken: PlanNode
    ) -> None:
        """Record a transition of a state. `is_taken`: the node that is true if the transition fires."""

    def note_state_choice(self, key: str, draw: PlanNode, weights: list[tuple[int, PlanNode]]) -> None:
        """Record a transition's choice of a state: the random draw and the weight of each state."""

    def note_layer(
        self, layer: model.Layer, budget_left: PlanNode, has_budget: PlanNode, condition_value: PlanNode, push: VectorNodes
    ) -> None:
        """Record a layer: the strength left for it, whether it is above 0, the value of the layer's condition, and the layer's
        push."""

    def note_steering(
        self, s: model.Steer | model.FaceLine | model.Layer, site: str, push: VectorNodes, condition_value: PlanNode | None = None
    ) -> None:
        """Record a `steer` line, or a `face` line of a state or of the layers. `condition_value`: whether the line's condition
        holds."""

    def note_resting_push(self, rest: model.RestingPush, push: VectorNodes) -> None:
        """Record the push of agents without a `steer` line."""

    # --- statements --------------------------------------------------------------------------------------------------

    def add_statement(self, statement: PlanStatement) -> None:
        """Append a statement to the current block."""
        self.statements.append(statement)

    def add_store(self, name: str, value: PlanNode, span: Span | None, allows_infinity: bool = False) -> None:
        """Add a store to a register. All later reads get the stored value. Nothing is added if the register already has this
        value."""
        kind = self.registers[name].kind
        if value.kind is not kind:
            raise PlanError(f"register {name} is a {kind.value} and cannot take a {value.kind.value}")
        if value is self.read_at_step_start(name):
            return
        self.add_statement(Store(name, value, span, allows_infinity))
        self.mark_written(name)

    def store_vector(self, name: str, value: VectorNodes, span: Span | None) -> None:
        """Add stores that set the three registers of a vector together. Each new component is computed from the previous values
        of all components."""
        names = [f"{name}.{axis}" for axis in AXES]
        parts = list(value)
        if any(self._has_load(part, set(names[:place])) for place, part in enumerate(parts)):
            for axis, part in zip(AXES, parts, strict=True):
                self.declare_register(f"{STORED_VECTOR_TEMP}.{axis}", ValueKind.F32, "temp")
                self.add_store(f"{STORED_VECTOR_TEMP}.{axis}", part, span)
            parts = list(self.read_vector(STORED_VECTOR_TEMP))
        for register, part in zip(names, parts, strict=True):
            self.add_store(register, part, span)

    @staticmethod
    def _has_load(node: PlanNode, names: set[str]) -> bool:
        return any(n.op == "load" and n.attrs[0] in names for n in collect_required_nodes([node]))

    def store_value(self, name: str, value: values.LoweredValue, span: Span | None, allows_infinity: bool = False) -> None:
        """Add the stores for a value of the language, in one or three registers."""
        if isinstance(value, VectorNodes):
            self.store_vector(name, value, span)
        elif isinstance(value, values.EntityRef):
            self.add_store(name, value.node, span)
        elif isinstance(value, PlanNode):
            self.add_store(name, value, span, allows_infinity)
        else:
            raise PlanError(f"{name} cannot hold a {type(value).__name__}")

    def advance_memory(self, memory: model.Binding) -> None:
        """Write the next value of a memory, unless the current path through the step has already written it. Also record that
        the current `let` uses the memory."""
        self.used_memories.append(memory)
        if memory in self._advanced_memories:
            return
        self._advanced_memories.add(memory)
        for register, node, span in self.memory_updates[memory]:
            self.add_store(register, node, span)

    # --- regions -----------------------------------------------------------------------------------------------------

    @contextmanager
    def collect_block(self) -> Iterator[Callable[[], Block]]:
        """Collect statements separately from the current block. Yields a function that returns the statements collected so far
        as a Block."""
        outer, self.statements = self.statements, []
        mine = self.statements
        try:
            yield lambda: Block(tuple(mine))
        finally:
            self.statements = outer

    @contextmanager
    def open_region(self, condition: PlanNode, span: Span | None) -> Iterator[None]:
        """Open a region. Statements added within the context run only where the condition holds."""
        outer = self.statements
        written, remembered = set(self._written), set(self._advanced_memories)
        if condition is self.b.true:
            yield
            return
        self.statements = []
        try:
            yield
        finally:
            inner, self.statements = self.statements, outer
            self._advanced_memories = remembered
            self.current_lets.clear()
            if condition is self.b.false:
                self._written = written
            elif inner:
                self.add_statement(If(condition, Block(tuple(inner)), span))

    def write_alternatives(self, cases: Sequence[tuple[PlanNode, Span | None, Callable[[], None]]]) -> None:
        """Write regions of which at most one applies to each agent. Stores in one region are not visible in the others.

        `cases`: for each region, its condition, its span, and a function that writes its statements."""
        entered = set(self._written)
        all_written = set(entered)
        for condition, span, write in cases:
            self._written = set(entered)
            with self.open_region(condition, span):
                write()
            all_written |= self._written
        self._written = all_written

    def read_run_value(self, name: str) -> PlanNode:
        """Return the node of a value of the run, such as `dt`."""
        return self.b("run", attrs=(name,))
