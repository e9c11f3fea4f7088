"""The names of the scalar fields that store the components of a field of vectors."""

from __future__ import annotations


def name_field_components(name: str) -> tuple[str, str, str]:
    """Return the names of the three scalar fields that store the components x, y and z of a field of vectors."""
    return f"{name}.x", f"{name}.y", f"{name}.z"
