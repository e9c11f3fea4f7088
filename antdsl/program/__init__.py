"""From files to meaning: `check` gives a Program with every name, type, unit and rate known.

The input is the tree as in the source, with names as text. The result is another tree: every name is resolved, every expression
has its type and rate, and behaviours replace their calls. The order is that of `checker`. Names are gathered (`names`).
Declarations are checked one by one (`declarations`) with the types of their expressions (`types`). Then the `checks` look at the
whole program. The built-in knowledge of the language is in `tables`. `memo` stores results about parts of a program, for an
editor that checks at every key. No scene is read here, so one program serves many scenes."""

from antdsl.program.checker import check

__all__ = ["check"]
