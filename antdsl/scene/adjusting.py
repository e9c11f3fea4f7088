"""Settings of fields that a scene, or the person who runs it, gives another value: `set: {trail.half_life: 4 s}`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from antdsl.program.model import Const, Dim, Expr, Field, Kind, Program, Rate, Type
from antdsl.scene.load import Scene
from antdsl.scene.quantities import Quantity

FADING = ("half_life", "evaporate", "keeps")  # of the ways to fade there is one
_DIMS = {
    "half_life": Dim(time=1),
    "evaporate": Dim(time=-1),
    "keeps": Dim(time=-1),
    "diffuse": Dim(length=2, time=-1),
    "limit": Dim(),
}


def dimension(program: Program, name: str) -> Dim | None:
    """What a setting of a field is measured in; None when the name is none."""
    field, _, word = name.partition(".")
    return _DIMS.get(word) if field in program.fields and name not in program.params else None


def settable(program: Program) -> list[str]:
    """The names of all settings of fields that can be given another value."""
    return [f"{field}.{word}" for field in program.fields for word in _DIMS]


def refused(name: str, value: Quantity) -> str:
    """Why a setting cannot have this value: what to write instead; nothing when it can."""
    word = name.partition(".")[2]
    if word == "keeps" and (value.step != -1 or not 0 <= value.number <= 1):
        return "write a share from `0 %/step` to `100 %/step`"
    above = word in ("half_life", "limit")
    if value.number < 0 or (above and value.number == 0):
        return f"write {'more than' if above else 'at least'} 0"
    return ""


def with_fields(program: Program, scene: Scene, values: Mapping[str, Quantity]) -> Program:
    """The program with these settings of its fields; names that are none are left alone."""
    fields = dict(program.fields)
    for name, value in values.items():
        dim = dimension(program, name)
        if dim is None:
            continue
        field, _, word = name.partition(".")
        place = scene.span("set", name) if name in scene.model.set else fields[field].span
        const = Const(Type(Kind.NUMBER, dim), Rate.CONST, place, value.number, u=value.u, step=value.step)
        fields[field] = with_field(fields[field], word, const)
    return replace(program, fields=fields)


def with_field(field: Field, word: str, value: Expr) -> Field:
    """A field with another value of one setting; of the ways to fade there is one."""
    values: dict[str, Any] = dict.fromkeys(FADING) if word in FADING else {}
    return replace(field, **{**values, word: value})
