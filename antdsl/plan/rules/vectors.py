"""Rules for vectors: a vector is three nodes."""

from __future__ import annotations

from antdsl.plan import values
from antdsl.plan.expressions import scalar, vector
from antdsl.plan.values import Value, Vec
from antdsl.plan.writing import Writer
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


def _rotate(w: Writer, e: model.Op) -> Value:
    v, axis = _pair(w, e)
    return values.rotate(w.b, v, values.unit(w.b, axis), scalar(w, e.args[2]))  # type: ignore[arg-type]


def _project(w: Writer, e: model.Op) -> Value:
    v, onto = _pair(w, e)
    way = values.unit(w.b, onto)
    return values.scale(w.b, way, values.dot(w.b, v, way))


def _limit(w: Writer, e: model.Op) -> Value:
    return values.limit(w.b, vector(w, e.args[0]), scalar(w, e.args[1]))  # type: ignore[arg-type]


def _vector(w: Writer, e: model.Op) -> Value:
    return Vec(*(scalar(w, a) for a in e.args if a is not None))


RULES = {
    "length": _length, "unit": _unit, "dot": _dot, "cross": _cross, "angle": _angle, "rotate": _rotate, "project": _project,
    "limit": _limit, "vector": _vector,
}  # fmt: skip
