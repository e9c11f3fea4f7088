"""Which name at which place stands for what: the occurrences of a file, by the checker's scope rules, from the tree alone.

It works on broken text too, and says nothing of types beyond whose attribute `meal.load` is."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

from antdsl.bounded import real_path
from antdsl.lsp.names import Key, Names, declaration
from antdsl.lsp.owners import Owner, owner_of
from antdsl.lsp.uses import Occurrence, Place, Uses
from antdsl.syntax import nodes


def occurrences(names: Names) -> list[Occurrence]:
    """Every name of a file, in text order."""
    walk = Walk(names)
    for item in names.file.items:
        walk.top(item)
    return walk.found


class Walk(Uses):
    """The walk over all that is around the expressions of a file."""

    # --- the top of a file ---

    def top(self, item: Any) -> None:
        _TOP[type(item)](self, item)

    def use(self, item: nodes.Use) -> None:
        if item.library is not None:
            self.say(item.library.span, ("library", item.library.text))
        if item.path is not None and item.alias is not None:
            self.say(item.path.span, ("file", str(self.names.modules.get(item.alias.text, item.path.text))))
            self.say(item.alias.span, ("alias", self.path, item.alias.text), True)

    def world(self, item: nodes.World) -> None:
        for thing in item.items:
            species = thing.kind.text == "species"
            self.say(thing.kind.span, ("kind", thing.kind.text))
            self.say(thing.name.span, ("species" if species else "thing", thing.name.text), True)
            for each in thing.attributes:
                self.say(each.name.span, ("own" if species else "attribute", thing.name.text, each.name.text), True)
                self.declared(each, Place(locals={}))

    def field(self, item: nodes.FieldDecl) -> None:
        self.say(item.name.span, ("field", item.name.text), True)
        for name in item.surfaces:
            self.say(name.span, self.world_key(name.text))
        for setting in item.settings:
            self.say(setting.name.span, ("setting", setting.name.text))
            if setting.name.text != "combine":
                self.expression(setting.value, Place(locals={}))

    def behaviour(self, item: nodes.Behaviour) -> None:
        name = item.name.text
        self.say(item.name.span, ("behaviour", self.path, name), True)
        local: dict[str, tuple[Key, Owner]] = {}
        place = Place(behaviour=name, locals=local)
        for argument in item.arguments:
            key = ("inner", self.path, name, argument.name.text)
            self.say(argument.name.span, key, True)
            self.type(argument.type)
            if argument.default is not None:
                self.expression(argument.default, place)
            local[argument.name.text] = (key, _typed_owner(argument.type))
        self.type(item.returns)
        for line in item.body:
            local[line.name.text] = (("inner", self.path, name, line.name.text), None)
        for line in item.body:
            self.say(line.name.span, ("inner", self.path, name, line.name.text), True)
            if isinstance(line, nodes.Keep):
                if line.type is not None:
                    self.type(line.type)
                self.expression(line.first, place)
                self.expression(line.then, place)
            else:
                self.expression(line.value, place)
                local[line.name.text] = (local[line.name.text][0], owner_of(self.names, place, line.value))
        self.expression(item.result, place)

    def type(self, type: nodes.TypeName) -> None:
        self.say(type.name.span, ("type", type.name.text))
        if type.of is not None:
            self.say(type.of.span, self.world_key(type.of.text))

    def species(self, item: nodes.Species) -> None:
        self.say(item.name.span, ("species", item.name.text), True)
        for member in item.members:
            self.member(member, Place(item.name.text, "main", locals={}))

    def spec(self, item: nodes.Spec) -> None:
        if item.scene is not None:
            self.scene_file(item.scene)
        named = [name for name, table in self.names.species.items() if table.node is not None]
        place = Place(named[0] if len(named) == 1 else None, spec=True)
        for line in item.lines:
            self.spec_line(line, place)

    def scene_file(self, scene: nodes.Text) -> None:
        self.say(scene.span, ("file", str(real_path(self.names.path.parent.joinpath(scene.text)))))

    def spec_line(self, line: nodes.SpecLine, place: Place) -> None:
        if line.kind == "each" and isinstance(line.target, nodes.NameRef):
            name = line.target.name
            self.say(name.span, ("species", name.text))
            place = replace(place, species=name.text)
        elif line.kind == "set" and isinstance(line.target, nodes.Member):
            self.setting(line.target)
        elif line.kind == "against" and isinstance(line.target, nodes.Text):
            self.scene_file(line.target)
        for part in (line.since, line.time, line.condition, line.held):
            if part is not None:
                self.expression(part, place)
        for inner in line.lines:
            self.spec_line(inner, place)

    def setting(self, target: nodes.Member) -> None:
        """`set forager.smell = …`, `set trail.half_life = …`."""
        owner = target.owner.name.text if isinstance(target.owner, nodes.NameRef) else ""
        if owner in self.names.fields:
            self.say(target.owner.span, ("field", owner))
            self.say(target.name.span, ("setting", target.name.text))
        elif owner:
            self.say(target.owner.span, ("species", owner))
            self.say(target.name.span, ("own", owner, target.name.text))

    # --- members of a species ---

    def member(self, member: Any, place: Place) -> None:
        declared = declaration(member)
        if declared is not None:
            self.say(declared.name.span, ("own", place.species, declared.name.text), True)
        _MEMBERS[type(member)](self, member, place)

    def declared(self, node: Any, place: Place) -> None:
        node = node.declaration if isinstance(node, nodes.ParamDecl) else node
        if node.type is not None:
            self.type(node.type)
        ends = (node.range.low, node.range.high) if node.range is not None else ()
        for part in (node.value, *ends, *((node.relax.to, node.relax.over) if node.relax is not None else ())):
            self.expression(part, place)
        if node.each is not None:
            self.say(node.each.species.span, ("species", node.each.species.text))

    def given(self, node: nodes.Given, place: Place) -> None:
        self.say(node.name.span, ("given", node.name.text))
        self.expression(node.value, place)

    def latch(self, node: nodes.Latch, place: Place) -> None:
        self.expression(node.on, place)
        self.expression(node.until, place)

    def fuzzy(self, node: nodes.Fuzzy, place: Place) -> None:
        for rule in node.rules:
            self.expression(rule.condition, place)
            self.expression(rule.value, place)

    def start(self, node: nodes.Start, place: Place) -> None:
        self.state_name(node.state, place.species, place.machine)

    def handler(self, node: nodes.On, place: Place) -> None:
        self.say(node.event.span, ("event", node.event.text), True)
        if node.variable is not None:
            key = ("element", node.variable)
            self.say(node.variable.span, key, True)
            place = replace(place, locals={node.variable.text: (key, ("agent", place.species or ""))})
        self.lines(node.actions, place)

    def layers(self, node: nodes.Layers, place: Place) -> None:
        for layer in node.layers:
            if isinstance(layer.push, nodes.NameRef) and layer.push.name.text == "state":
                self.say(layer.push.span, ("steered", "state"))
            else:
                self.expression(layer.push, place)
            if layer.condition is not None:
                self.expression(layer.condition, place)

    def machine(self, node: nodes.Machine, place: Place) -> None:
        self.say(node.name.span, ("machine", place.species, node.name.text), True)
        for member in node.members:
            self.member(member, replace(place, machine=node.name.text))

    def state(self, node: nodes.State, place: Place) -> None:
        self.say(node.name.span, ("state", place.species, place.machine, node.name.text), True)
        if node.colour is not None:
            self.say(node.colour.span, ("colour", node.colour.text))
        if node.at_least is not None:
            self.expression(node.at_least, place)
        local = dict(place.locals)
        place = replace(place, locals=local)
        for line in node.body:
            if isinstance(line, nodes.Let):
                key = ("let", place.species, place.machine, node.name.text, line.name.text)
                local[line.name.text] = (key, owner_of(self.names, place, line.value))
                self.say(line.name.span, key, True)
        for line in (*node.body, *node.enter, *node.exit):
            self.line(line, place)

    # --- lines ---

    def lines(self, lines: tuple[Any, ...], place: Place) -> None:
        for line in lines:
            self.line(line, place)

    def line(self, line: Any, place: Place) -> None:
        _LINES[type(line)](self, line, place)

    def change(self, node: nodes.Change, place: Place) -> None:
        for name in node.any_except or ():
            self.state_name(name, place.species, place.machine)
        for part in (node.condition, node.after, node.held):
            if part is not None:
                self.expression(part, place)
        if node.take is not None:
            self.exchange(node.take.attribute, node.take.source, node.take.amount, place)
        if node.target.name is not None and not node.target.previous:
            self.state_name(node.target.name, place.species, place.machine)
        for choice in node.target.choices:
            self.state_name(choice.target, place.species, place.machine)
            self.expression(choice.weight, place)
        self.lines(node.actions, place)

    def exchange(self, attribute: nodes.Name, thing: nodes.Expr, amount: nodes.Expr | None, place: Place) -> None:
        """`take 1 load from meal`: the animal's `load` and the item's."""
        if amount is not None:
            self.expression(amount, place)
        self.say(attribute.span, ("own", place.species, attribute.text))
        owner = owner_of(self.names, place, thing)
        if owner is not None and owner[0] in ("item", "things"):
            self.say(attribute.span, ("attribute", owner[1], attribute.text))
        self.expression(thing, place)

    def give(self, node: nodes.Give, place: Place) -> None:
        self.exchange(node.attribute, node.to, node.amount, place)

    def assign(self, node: nodes.Assign, place: Place) -> None:
        self.expression(node.target, place)
        self.expression(node.value, place)

    def steer(self, node: nodes.Steer, place: Place) -> None:
        self.expression(node.push, place)

    def deposit(self, node: nodes.Deposit, place: Place) -> None:
        self.say(node.field.span, ("field", node.field.text))
        self.expression(node.amount, place)

    def carve(self, node: nodes.Carve, place: Place) -> None:
        self.say(node.solid.span, self.world_key(node.solid.text))
        self.arguments("carve", node.arguments, place)

    def emit(self, node: nodes.Emit, place: Place) -> None:
        self.say(node.event.span, ("event", node.event.text))
        self.arguments("emit", node.arguments, place)

    def spawn(self, node: nodes.Spawn, place: Place) -> None:
        self.say(node.species.span, ("species", node.species.text))

    def local_let(self, node: nodes.Let, place: Place) -> None:
        self.expression(node.value, place)

    def own_let(self, node: nodes.Let, place: Place) -> None:
        self.expression(node.value, place)

    def nothing(self, node: Any, place: Place) -> None:
        """A line without names."""


def _typed_owner(type: nodes.TypeName) -> Owner:
    if type.of is None:
        return None
    return ("item" if type.name.text in ("item", "items") else "agent", type.of.text)


_TOP: dict[type, Callable[[Walk, Any], None]] = {
    nodes.Use: Walk.use, nodes.World: Walk.world, nodes.FieldDecl: Walk.field, nodes.Behaviour: Walk.behaviour,
    nodes.Species: Walk.species, nodes.Spec: Walk.spec,
}  # fmt: skip
_LINES: dict[type, Callable[[Walk, Any, Place], None]] = {
    nodes.Steer: Walk.steer, nodes.Assign: Walk.assign, nodes.Deposit: Walk.deposit, nodes.Carve: Walk.carve,
    nodes.Emit: Walk.emit, nodes.Spawn: Walk.spawn, nodes.Die: Walk.nothing, nodes.Play: Walk.nothing, nodes.Give: Walk.give,
    nodes.Change: Walk.change, nodes.Let: Walk.local_let,
}  # fmt: skip
_MEMBERS: dict[type, Callable[[Walk, Any, Place], None]] = {
    nodes.ParamDecl: Walk.declared, nodes.Declaration: Walk.declared, nodes.Given: Walk.given, nodes.Let: Walk.own_let,
    nodes.Latch: Walk.latch, nodes.Fuzzy: Walk.fuzzy, nodes.Start: Walk.start, nodes.On: Walk.handler,
    nodes.Layers: Walk.layers, nodes.Machine: Walk.machine, nodes.State: Walk.state, nodes.Change: Walk.change,
}  # fmt: skip
