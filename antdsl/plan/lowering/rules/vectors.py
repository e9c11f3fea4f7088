"""Rules for vectors: a vector is three nodes."""

from __future__ import annotations

from antdsl.plan.lowering import values
from antdsl.plan.lowering.expressions import scalar, vector
from antdsl.plan.lowering.values import Value, Vec
from antdsl.plan.lowering.writer import Writer
from antdsl.program import model


def _length(w: Writer, e: model.Op) -> Value:
    return values.length(w.b, vector(w, e.args[0]))  # type: ignore[arg-type]


def _unit(w: Writer, e: model.Op) -> Value:
    return values.unit(w.b, vector(w, e.args[0]))  # type: ignore[arg-type]


def _pair(w: Writer, e: model.Op) -> tuple[Vec, Vec]:
    return vector(w, e.args[0]), vector(w, e.args[1])  # type: ignore[arg-type]


def _dot(w: Writer, e: model.Op) -> Value:
    return values.dot(w.b, *_pair(w, e))


def _cross(w: Writer, e: model.Op) -> Value:
    return values.cross(w.b, *_pair(w, e))


def _angle(w: Writer, e: model.Op) -> Value:
    return values.angle_between(w.b, *_pair(w, e))


def _way(w: Writer, e: model.Expr) -> Vec:
    """A direction of length 1; `up` and `heading` are so already."""
    if isinstance(e, model.Attribute) and e.of is None and e.name in ("up", "heading"):
        return vector(w, e)
    return values.unit(w.b, vector(w, e))


def _rotate(w: Writer, e: model.Op) -> Value:
    return values.rotate(w.b, vector(w, e.args[0]), _way(w, e.args[1]), scalar(w, e.args[2]))  # type: ignore[arg-type]


def _project(w: Writer, e: model.Op) -> Value:
    way = _way(w, e.args[1])  # type: ignore[arg-type]
    return values.scale(w.b, way, values.dot(w.b, vector(w, e.args[0]), way))  # type: ignore[arg-type]


def _limit(w: Writer, e: model.Op) -> Value:
    return values.limit(w.b, vector(w, e.args[0]), scalar(w, e.args[1]))  # type: ignore[arg-type]


def _vector(w: Writer, e: model.Op) -> Value:
    return Vec(*(scalar(w, a) for a in e.args if a is not None))


RULES = {
    "length": _length, "unit": _unit, "dot": _dot, "cross": _cross, "angle": _angle, "rotate": _rotate, "project": _project,
    "limit": _limit, "vector": _vector,
}  # fmt: skip
