"""One agent of a plan, stepped in plain Python: what lowering means, without a runtime. The test gives senses and draws."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

from antdsl.plan import ir
from antdsl.plan.ir import Block, PlanNode
from antdsl.plan.simplify import ARITHMETIC_FUNCTIONS, COMPARISON_FUNCTIONS, round_to_f32

KERNELS: dict[str, Callable[..., float]] = {
    "sin": math.sin, "cos": math.cos, "exp": math.exp, "atan2": math.atan2, "pow": math.pow,
    "log": lambda x: math.log(x) if x > 0 else -math.inf,
    "min": min, "max": max,
}  # fmt: skip


class Agent:
    """`senses` maps an operation's name, or (name, attributes…), to a value or a function of the operands' values."""

    def __init__(self, plan: ir.Plan, species: str, *, dt: float = 1 / 24, **senses: Any) -> None:
        self.plan, self.species, self.dt = plan, plan.species[species], dt
        self.senses: dict[Any, Any] = dict(senses)
        self.params: dict[str, float] = {}
        self.done: list[tuple[Any, ...]] = []
        self.win = True
        self.frame = 0
        self.now: dict[str, Any] = {name: r.initial_value for name, r in self.species.registers.items()}
        self.now |= {"heading.x": 1.0, "up.y": 1.0}
        self.start = dict(self.now)
        self._run(self.species.born)

    def __getitem__(self, register: str) -> Any:
        return self.now[register]

    @property
    def state(self) -> str:
        machine = self.species.machines[0]
        return machine.states[self.now[f"{machine.name}.state"]]

    @property
    def push(self) -> tuple[float, float, float]:
        return self.now["push.x"], self.now["push.y"], self.now["push.z"]

    def step(self, times: int = 1) -> Agent:
        for _ in range(times):
            self.done = []
            for name, register in self.species.registers.items():
                if register.role == "temp":
                    self.now[name] = register.initial_value
            self.start = dict(self.now)
            for phase in (self.species.decide, self.species.act, self.species.blend):
                self._run(phase)
            self.frame += 1
        return self

    def _run(self, block: Block) -> None:
        for s in block.statements:
            match s:
                case ir.If():
                    if self.value(s.condition):
                        self._run(s.body)
                case ir.Store():
                    value = self.value(s.value)
                    assert s.allows_infinity or not isinstance(value, float) or math.isfinite(value), s
                    self.now[s.register] = value
                case ir.Claim():
                    assert s.item is not None and s.amount is not None
                    self.done.append(("claim", s.target, s.attribute, self.value(s.item), self.value(s.amount)))
                    self.now[s.won_register] = self.win
                    if s.register and self.win:
                        self.now[s.register] += self.value(s.amount)
                case ir.Give():
                    amount = self.now[s.register] if s.amount is None else min(self.now[s.register], self.value(s.amount))
                    self.now[s.register] -= amount
                    self.done.append(("give", s.items, self.value(s.item), amount))
                case ir.Request():
                    of = (s.target,) if s.target else ()
                    self.done.append((s.op, *of, *(None if node is None else self.value(node) for node in s.args)))

    def value(self, node: PlanNode) -> Any:
        """Recomputed at each asking: sharing must not be what makes a plan right."""
        op, attrs = node.op, node.attrs
        if op.startswith("const"):
            return attrs[0]
        if op == "snap":
            return self.start[attrs[0]]
        if op == "load":
            return self.now[attrs[0]]
        if op == "run":
            return {"dt": round_to_f32(self.dt), "u": 1.0, "up_x": 0.0, "up_y": 1.0, "up_z": 0.0}[attrs[0]]
        if op == "step":
            return float(self.frame) if attrs[0] == "frame" else round_to_f32(self.frame * self.dt)
        if op == "param":
            return self.params.get(attrs[0], self.value(self.plan.params[attrs[0]].default))
        if op == "where":
            return self.value(node.args[1] if self.value(node.args[0]) else node.args[2])
        if op == "get":
            return self.value(node.args[0])[attrs[0]]
        values = [self.value(a) for a in node.args if a.rate is not ir.UpdateRate.PAIR and a.kind is not ir.ValueKind.SET]
        return self._computed(op, attrs, values)

    def _computed(self, op: str, attrs: tuple, values: list[Any]) -> Any:
        if op in ARITHMETIC_FUNCTIONS:
            return round_to_f32(ARITHMETIC_FUNCTIONS[op](*values))
        if op in COMPARISON_FUNCTIONS:
            return COMPARISON_FUNCTIONS[op](*values)
        if op in KERNELS:
            return round_to_f32(KERNELS[op](*values))
        if op in ("and", "or"):
            return all(values) if op == "and" else any(values)
        if op == "not":
            return not values[0]
        if op == "number":
            return float(values[0])
        if op in ("item.alive", "agent.alive") and op not in self.senses:
            return values[0] >= 0
        sense = self.senses.get((op, *attrs), self.senses.get(op))
        assert sense is not None, f"no sense for {op} {attrs}"
        return sense(*values) if callable(sense) else sense
