"""From files to meaning: `check` gives a Program with every name, type, unit and rate known.

In goes the tree as it was written, with names as text; out comes another tree, in which every name is what it stands for, every
expression has its type and rate, and behaviours stand in the place of their calls. The order is that of `checker`: names are
gathered (`names`), declarations are checked one by one (`declarations`) with the types of their expressions (`types`), then the
`checks` look at the whole program. What the language knows by itself is in `tables`. `memo` keeps what was found about parts of a
program, for an editor that checks at every key. No scene is seen here, so one program serves many scenes."""

from antdsl.program.checker import check

__all__ = ["check"]
