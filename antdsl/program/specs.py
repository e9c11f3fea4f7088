"""Specs, looked at lightly: their names, the species and items they count, and the scene they run on."""

from __future__ import annotations

from antdsl.program.collect import EVENTS
from antdsl.program.model import Kind, Type
from antdsl.program.operators import wanted
from antdsl.program.scope import TIME, Declared, FileNames, attributes_of, did_you_mean, listed
from antdsl.program.vocabulary import BUILTINS, REDUCERS, RUN_NAMES
from antdsl.program.walk import written
from antdsl.program.world import outside
from antdsl.syntax import nodes

_WORDS = ("at_start", "motion", "state", *RUN_NAMES)
_CALLS = ("total", "share", "mean", "min", "max", "count", "any", "every", "at_start", "abs", "first")


def check_spec(declared: Declared, names: FileNames, spec: nodes.Spec) -> nodes.Spec:
    """Complain about what a spec asks for that cannot be there."""
    if spec.scene is not None and not spec.scene.text.endswith((".yaml", ".yml")):
        declared.report.error(
            "not-a-scene", f"`{spec.scene.text}` is not the name of a scene", spec.scene.span, 'write `on "scene.yaml"`'
        )
    for line in spec.lines:
        _line(declared, names, line, None)
    return spec


def _line(declared: Declared, names: FileNames, line: nodes.SpecLine, species: str | None) -> None:
    if line.time is not None:
        wanted(outside(declared, names, "spec"), line.time, TIME, f"`{line.kind}`")
    if line.kind == "set":
        _set(declared, line)
        return
    if line.kind == "each" and isinstance(line.target, nodes.NameRef):
        species = line.target.name.text
        if species not in declared.species:
            declared.report.error(
                "unknown-species", f"no species `{species}`", line.target.span, did_you_mean(species, declared.species)
            )
            return
    if line.condition is not None and line.kind != "seeds":
        _names(declared, line.condition, species)
    for inner in line.lines:
        _line(declared, names, inner, species)


def _set(declared: Declared, line: nodes.SpecLine) -> None:
    text = line.target.span.text.strip() if line.target is not None else ""
    params = [f"{s.name}.{p}" for s in declared.species.values() for p in s.params]
    known = params + [
        f"{field}.{word}" for field in declared.fields for word in ("half_life", "evaporate", "keeps", "diffuse", "limit")
    ]
    if line.target is not None and text not in known:
        declared.report.error(
            "unknown-name",
            f"no param `{text}` to set",
            line.target.span,
            did_you_mean(text, known, f"there is {listed(params)}" if params else None),
        )
    elif text in params:
        declared.used.add(("param", text))


def _names(declared: Declared, root: nodes.Expr, species: str | None) -> None:
    """Every name of a condition, and every value of a species or of items; elements of sets are let through."""
    members: dict[int, nodes.Member] = {}
    calls: set[int] = set()
    bound: set[str] = set()
    for part, _ in written(root):
        if isinstance(part, nodes.Member) and isinstance(part.owner, nodes.NameRef):
            members[id(part.owner)] = part
        elif isinstance(part, nodes.Call) and isinstance(part.function, nodes.NameRef):
            calls.add(id(part.function))
            name = part.function.name
            if name.text not in _CALLS and name.text not in BUILTINS and name.text not in REDUCERS:
                declared.report.error(
                    "unknown-behaviour",
                    f"a spec cannot ask `{name.text}(…)`",
                    name.span,
                    did_you_mean(name.text, _CALLS, f"it can ask {listed(_CALLS)}"),
                )
        elif isinstance(part, nodes.Comprehension):
            bound.add(part.variable.text)
        elif isinstance(part, nodes.NameRef) and id(part) not in calls and part.name.text not in bound:
            _name(declared, part, members.get(id(part)), species)


def _name(declared: Declared, ref: nodes.NameRef, member: nodes.Member | None, species: str | None) -> None:
    name = ref.name.text
    names = declared.species.get(name)
    thing = declared.things.get(name)
    if member is not None and (names is not None or (thing is not None and thing.kind == "items")):
        type = Type(Kind.AGENT, of=name) if names is not None else Type(Kind.ITEM, of=name)
        known = set(attributes_of(declared, type)) | ({"state"} if names is not None else set())
        if member.name.text not in known:
            declared.report.error(
                "unknown-name", f"`{name}` has no `{member.name.text}`", member.name.span, did_you_mean(member.name.text, known)
            )
        declared.used.add(("attribute", f"{name}.{member.name.text}"))
        return
    if _known(declared, name, species):
        return
    where = (ref.span.source.path, "spec", name)
    if where in declared.told:
        return
    declared.told.add(where)
    known = {*declared.species, *declared.things, *declared.fields, *_WORDS}
    declared.report.error(
        "unknown-name", f"no `{name}` is known here", ref.span, did_you_mean(name, known, f"there is {listed(known)}")
    )


def _known(declared: Declared, name: str, species: str | None) -> bool:
    if name in declared.fields:
        declared.used.add(("field", name))
    own = declared.species.get(species) if species else None
    if own is not None and (name in own.attributes or name in attributes_of(declared, Type(Kind.AGENT, of=own.name))):
        declared.used.add(("attribute", f"{own.name}.{name}"))
        return True
    machines = [machine for each in declared.species.values() for machine in each.machines.values()]
    states = any(name in machine.states or name == machine.name for machine in machines)
    events = name in declared.events or name in EVENTS
    return states or events or name in _WORDS or name in declared.species or name in declared.things or name in declared.fields
