"""Layers, which bind shapes to a rig, and transform groups, which name parts of it."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Binding:
    """A shape at a joint (`transform`; "" for a deforming one that follows many). `deformer`: "" for a static shape."""

    transform: str
    shape: str
    bounds_scale: tuple[float, float, float] = (1.0, 1.0, 1.0)
    deformer: str = ""


@dataclass(frozen=True, slots=True)
class Layer:
    """Shapes that are drawn together."""

    name: str
    static: tuple[Binding, ...] = ()
    deforming: tuple[Binding, ...] = ()


@dataclass(frozen=True, slots=True)
class TransformGroup:
    """A named part of a rig: joints with weights from 0 to 1, and channels."""

    name: str
    members: tuple[tuple[str, float], ...] = ()
    channels: tuple[str, ...] = ()
