"""Plans built by hand, for tests of the runtime: every operation and statement of the plan, without a program behind."""

from __future__ import annotations

from fractions import Fraction

import numpy as np

from antdsl.plan import ir
from antdsl.plan.builder import PlanBuilder
from antdsl.runtime import CrowdData, ItemData, WorldSetting
from antdsl.scene.setting import PlacementData

DEFAULT_ATTRIBUTES = {
    "size": 4.0,
    "mass": 1.0,
    "radius": 2.0,
    "clearance": 0.0,
    "max_speed": 30.0,
    "response": 0.15,
    "max_force": 200.0,
    "group": 0.0,
}
VECTORS = ("position", "velocity", "heading", "up")


def registers(*extra: ir.Register) -> dict[str, ir.Register]:
    """What every species has, and more."""
    defaults = [ir.Register(f"{v}.{a}", ir.ValueKind.F32, "attribute") for v in VECTORS for a in "xyz"]
    defaults += [ir.Register(name, ir.ValueKind.F32, "attribute", zero) for name, zero in DEFAULT_ATTRIBUTES.items()]
    defaults.append(ir.Register("max_turn", ir.ValueKind.F32, "attribute", float("inf")))
    defaults += [ir.Register(f"push.{a}", ir.ValueKind.F32, "temp") for a in "xyz"]
    return {r.name: r for r in (*defaults, *extra)}


def machine(*states: str) -> tuple[ir.MachinePlan, list[ir.Register]]:
    kinds = {"state": ir.ValueKind.I32, "previous": ir.ValueKind.I32, "next": ir.ValueKind.I32, "time_in_state": ir.ValueKind.F32}
    return ir.MachinePlan("main", states, states, ((1.0, 0.0, 0.0),) * len(states)), [
        ir.Register(f"main.{name}", kind, "memory") for name, kind in kinds.items()
    ]


class Text:
    """Shorter words for a Builder."""

    def __init__(self) -> None:
        self.b = PlanBuilder()

    def __call__(self, op: str, *args: ir.PlanNode | float, attrs: tuple = (), kind: ir.ValueKind | None = None) -> ir.PlanNode:
        return self.b(op, *(self.b.add_number(a) if isinstance(a, int | float) else a for a in args), attrs=attrs, kind=kind)

    def snap(self, name: str, kind: ir.ValueKind = ir.ValueKind.F32) -> ir.PlanNode:
        return self.b("snap", attrs=(name,), kind=kind)

    def load(self, name: str, version: int, kind: ir.ValueKind = ir.ValueKind.F32) -> ir.PlanNode:
        return self.b("load", attrs=(name, version), kind=kind)

    def draw(self, site: str, index: int = 0) -> ir.PlanNode:
        return self.b("draw", attrs=(site, index))

    def get(self, node: ir.PlanNode, index: int) -> ir.PlanNode:
        return self.b("get", node, attrs=(index,))

    def vector(self, name: str) -> list[ir.PlanNode]:
        return [self.snap(f"{name}.{a}") for a in "xyz"]


def block(*statements: ir.PlanStatement) -> ir.Block:
    return ir.Block(statements)


def store(name: str, value: ir.PlanNode, infinite: bool = False) -> ir.Store:
    return ir.Store(name, value, None, infinite)


def when(condition: ir.PlanNode, *statements: ir.PlanStatement) -> ir.If:
    return ir.If(condition, block(*statements), None)


def rich() -> ir.Plan:
    """Ants that search, take food and bring it home, with neighbours, events, births and deaths; and flies that watch them."""
    t = Text()
    F, B, R, L = ir.ValueKind.F32, ir.ValueKind.BOOL, ir.ValueKind.I32, ir.ValueKind.I64
    main, bookkeeping = machine("search", "carry")
    ant_registers = registers(
        *bookkeeping,
        ir.Register("load", F, "attribute"),
        ir.Register("fear", F, "attribute", 1.0),
        ir.Register("bearing", F, "memory"),
        ir.Register("friend", L, "attribute", -1, referenced_species="ant"),
        ir.Register("source", R, "attribute", -1),
        ir.Register("quiet", B, "memory"),
        ir.Register("main.pending", R, "temp"),
        ir.Register("won", B, "temp"),
    )
    state = t.snap("main.state", R)
    everywhere = t("set.items", float("inf"), attrs=("food",))
    nearby_food = t("set.items", t("mul", t("param", attrs=("ant.smell",)), t("run", attrs=("u",))), attrs=("food",))
    meal = t("reduce.item", nearby_food, t("gt", t("other", attrs=("load",)), 0), t("pair.distance"))
    home = t("reduce.item", t("set.items", float("inf"), attrs=("nest",)), t.b.true, t("pair.distance"))
    near = t("set.agents", 12.0, 0.3, attrs=("ant", False))
    around = t("set.agents", t("mul", t.snap("size"), 3.0), -1.0, attrs=("ant", True))
    flies = t("set.every", attrs=("fly",))
    shy = t("sub", 1.0, t("div", t("pair.distance"), 12.0))
    away = [
        t("reduce.sum", around, t("gt", t("other", attrs=("size",)), 1.0), t("mul", t("neg", t(f"pair.{a}")), shy), attrs=(-24,))
        for a in "xyz"
    ]
    heading = [t("reduce.sum", near, t.b.true, t("other", attrs=(f"heading.{a}",)), attrs=(-24,)) for a in "xyz"]
    best_friend = t("reduce.agent", near, t.b.true, t("neg", t("abs", t("sub", t("other", attrs=("fear",)), t.snap("fear")))))
    fear_of_flies = t("reduce.max", flies, t.b.true, t("exp", t("neg", t("mul", t("pair.distance"), 0.05))))
    nearest_fly = t("reduce.min", flies, t("ne", t("other.id"), t.b.add_agent_id(0)), t("pair.distance"))
    touching = t("le", t("pair.distance"), t("add", t("other", attrs=("radius",)), t.snap("radius")))
    at_food = t("reduce.any", nearby_food, t("and", touching, t("ge", t("number", t("other.row")), 0.0)))
    crowd = t("reduce.count", around, t("lt", t("pair.distance"), 8.0))

    hungry = t("and", t("eq", state, t.b.add_row(0)), t("item.alive", meal, attrs=("food",)))
    friend = t.snap("friend", L)
    decide = block(
        when(t("event", attrs=("alarm",)), store("fear", t("min", t("add", t.snap("fear"), 0.5), 3.0))),
        when(
            hungry,
            when(
                t("or", at_food, t("lt", t.draw("leap"), 0.02)),
                store("main.pending", t.b.add_row(1)),
                ir.Claim("food", "load", meal, t("add", 1.0, t("mul", t.draw("greed", 1), 0.1)), "won", "load", "claim", None),
            ),
        ),
        when(
            t("and", t("eq", state, t.b.add_row(1)), t("lt", t("item.get", home, attrs=("nest", "radius")), 100.0)),
            when(t("gt", t.snap("main.time_in_state"), 0.4), store("main.pending", t.b.add_row(2))),
        ),
        store("quiet", t("not", t("lt", fear_of_flies, 0.4))),
    )
    pending = t.load("main.pending", 2, R)
    won = t.load("won", 1, B)
    act = block(
        store("main.time_in_state", t("add", t.snap("main.time_in_state"), t("run", attrs=("dt",)))),
        when(
            t("and", t("eq", pending, t.b.add_row(1)), won),
            store("main.state", t.b.add_row(1)),
            store("main.time_in_state", t.b.add_number(0)),
            store("source", meal),
            store("friend", t("draw.agent", attrs=("pick", "ant"))),
            ir.Request("emit", "alarm", (t("mul", t.snap("size"), 4.0), None), None),
        ),
        when(
            t("eq", pending, t.b.add_row(2)),
            ir.Give("nest", "load", home, t("mul", t.load("load", 1), 0.5), "load", None),
            ir.Give("nest", "load", home, None, "load", None),
            store("main.state", t.b.add_row(0)),
            when(t("lt", t.draw("child"), 0.3), ir.Request("spawn", "ant", (), None, site="child")),
            when(t("gt", t.draw("child", 3), 0.8), ir.Request("die", "", (), None)),
            ir.Request("emit", "alarm", (None, None), None),
        ),
        when(
            t("gt", t("abs", t("sub", t("load", attrs=("load", 3)), t.snap("load"))), 0.0),
            store("fear", t("mul", t.snap("fear"), 0.9)),
        ),
        when(t("agent.alive", friend, attrs=("ant",)), store("friend", best_friend)),
    )
    swing = t(
        "mul", t("sqrt", t("mul", -2.0, t("log", t("sub", 1.0, t.draw("w"))))), t("cos", t("mul", 6.2831853, t.draw("w", 1)))
    )
    bearing = t("add", t.snap("bearing"), t("mul", swing, 0.2))
    h, u = t.vector("heading"), t.vector("up")
    side = [
        t("sub", t("mul", u[1], h[2]), t("mul", u[2], h[1])),
        t("sub", t("mul", u[2], h[0]), t("mul", u[0], h[2])),
        t("sub", t("mul", u[0], h[1]), t("mul", u[1], h[0])),
    ]
    wander = [t("add", t("mul", a, t("cos", bearing)), t("mul", s, t("sin", bearing))) for a, s in zip(h, side, strict=True)]
    friendly = [t("mul", t("agent.get", best_friend, attrs=("ant", f"velocity.{a}")), 0.01) for a in "xyz"]
    scale = t(
        "div", t("pow", t("max", t.snap("fear"), 0.1), 0.5), t("add", t("number", t.snap("quiet", B)), t("max", 1.0, crowd))
    )
    turn = t("atan2", heading[0], heading[2])
    food = [t("sub", t("item.get", meal, attrs=("food", a)), p) for a, p in zip("xyz", t.vector("position"), strict=True)]
    blend = block(
        store("bearing", t("sub", bearing, t("mul", t("floor", t("div", bearing, 6.2831853)), 6.2831853))),
        *(
            store(
                f"push.{a}",
                t(
                    "finite",
                    t("add", t("mul", w, 0.5), t("mul", t("add", t("add", p, f), t("mul", turn, 0.01)), t("mul", scale, 0.1))),
                ),
            )
            for a, w, p, f in zip("xyz", wander, away, friendly, strict=True)
        ),
        when(
            t("and", t("item.alive", meal, attrs=("food",)), t("eq", t.load("main.state", 2, R), t.b.add_row(0))),
            *(store(f"push.{a}", t("div", f, t("max", 1.0, t("abs", f)))) for a, f in zip("xyz", food, strict=True)),
        ),
        when(
            t("le", nearest_fly, 5.0),
            *(
                store(f"push.{a}", t("where", t("gt", t("age"), 0.2), t("neg", t.load(f"push.{a}", 2)), t.load(f"push.{a}", 2)))
                for a in "xyz"
            ),
        ),
    )
    born = block(
        store("size", t("add", 3.6, t("mul", t.draw("size"), 0.8))),
        store("radius", t("mul", t.load("size", 1), 0.5)),
        store(
            "max_turn",
            t("where", t("lt", t.draw("stiff"), 0.5), t.b.add_number(float("inf")), t.b.add_number(9.0)),
            infinite=True,
        ),
        store("fear", t("add", t("sin", t("number", t("eq", t("id"), t.b.add_agent_id(3)))), 0.5)),
    )
    ant = ir.SpeciesPlan(
        "ant", ant_registers, (main,), born, decide, act, blend, ("alarm",), (), memoised_senses=(meal, best_friend, crowd)
    )
    late = t("ge", t("step", attrs=("time",)), t("mul", 8.0, t("run", attrs=("dt",))))
    chase = t("reduce.agent", t("set.every", attrs=("ant",)), t("surface.touching", attrs=("ground",)), t("pair.distance"))
    fly_blend = block(
        store("prey", chase),
        *(
            store(f"push.{a}", t("mul", t("sub", t("agent.get", t.load("prey", 1, L), attrs=("ant", f"position.{a}")), p), 0.05))
            for a, p in zip("xyz", t.vector("position"), strict=True)
        ),
        when(
            late,
            store("hops", t("add", t.snap("hops"), t("number", t("reduce.any", everywhere, t("lt", t("pair.distance"), 60.0))))),
        ),
    )
    fly_registers = registers(
        ir.Register("prey", L, "attribute", -1, referenced_species="ant"), ir.Register("hops", F, "attribute")
    )
    fly = ir.SpeciesPlan(
        "fly", fly_registers, (), block(store("response", t.b.add_number(0))), block(), block(), fly_blend, (), ()
    )
    return ir.Plan(
        species={"ant": ant, "fly": fly},
        fields={},
        items={"food": ir.ItemsPlan("food", {"load": 0.0}), "nest": ir.ItemsPlan("nest", {"load": 0.0})},
        params={"ant.smell": ir.ParamPlan("ant.smell", t.b.add_number(40.0))},
        thing_names_by_kind={"surface": ("ground",)},
        nodes=tuple(t.b.nodes),
    )


def setting(ants: int = 40, flies: int = 3, **overrides: object) -> WorldSetting:
    """The plane, three sources of food, a nest, and a crowd about the middle."""
    items = {
        "food": (
            ItemData("near", (30.0, 0.0, 10.0), 6.0, {"load": 9.5}),
            ItemData("far", (-60.0, 0.0, 20.0), 8.0, {"load": 50.0}),
            ItemData("empty", (0.0, 0.0, 25.0), 5.0),
        ),
        "nest": (ItemData("home", (0.0, 0.0, 0.0), 10.0),),
    }
    crowds = (
        CrowdData("ant", ants, PlacementData(disc_centre=(0.0, 0.0, 0.0), radius=35.0)),
        CrowdData(
            "fly", flies, PlacementData(points=np.array([[50.0, 0.0, 0.0], [0.0, 0.0, 50.0], [-20.0, 0.0, 0.0]])), line_index=1
        ),
    )
    defaults = dict(fps=Fraction(24), seed=11, items=items, crowds=crowds)
    return WorldSetting(**{**defaults, **overrides})  # type: ignore[arg-type]


def bare(
    act: ir.Block,
    *numbers: str,
    decide: ir.Block | None = None,
    blend: ir.Block | None = None,
    born: ir.Block | None = None,
    extra_registers: tuple[ir.Register, ...] = (),
    **plan: object,
) -> ir.Plan:
    """One species with some number registers and nothing else to do."""
    ant_registers = registers(*(ir.Register(name, ir.ValueKind.F32, "attribute") for name in numbers), *extra_registers)
    empty = block()
    ant = ir.SpeciesPlan("ant", ant_registers, (), born or empty, decide or empty, act, blend or empty, (), ())
    defaults: dict = dict(fields={}, items={}, params={}, thing_names_by_kind={})
    return ir.Plan(species={"ant": ant}, **{**defaults, **plan})


def crowd(count: int, radius: float = 40.0, **overrides: object) -> WorldSetting:
    """So many ants about the origin."""
    crowds = (CrowdData("ant", count, PlacementData(disc_centre=(0.0, 0.0, 0.0), radius=radius)),)
    return WorldSetting(**{**dict(seed=3, crowds=crowds), **overrides})  # type: ignore[arg-type]
