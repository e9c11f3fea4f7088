"""Checks parsed files. `check` returns a Program in which every name, type, unit and rate is known.

The input is the syntax tree, in which names are text. The result is another tree, with all names resolved, a type and a rate for
every expression, and all behaviour calls expanded. The steps, in the order of `checker`:
- `names` collects the declared names.
- `declarations` checks each declaration, and `types` the expressions in it.
- `checks` examines the complete program.

The package `tables` holds the built-in words of the language. `memo` caches results about parts of a program, because an editor
runs a check at every key press. No scene is read, so many scenes can use one program."""

from antdsl.program.checker import check

__all__ = ["check"]
