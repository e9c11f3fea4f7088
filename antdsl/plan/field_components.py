"""The names of the three scalar fields that store a vector field."""

from __future__ import annotations


def name_field_components(name: str) -> tuple[str, str, str]:
    """Return the names of the three scalar fields that store the x, y and z components of the vector field `name`."""
    return f"{name}.x", f"{name}.y", f"{name}.z"
