"""From files to meaning: `check` gives a Program with every name, type, unit and rate known."""

from antdsl.program.checker import check

__all__ = ["check"]
