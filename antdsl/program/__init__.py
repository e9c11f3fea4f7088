"""Checks parsed files. `check` returns a Program in which every name, type, unit and rate is known.

The input is the syntax tree, which has names as text. The result is another tree. In it every name is resolved, every expression
has its type and rate, and each call of a behaviour is expanded. The steps, in the order of `checker`:
- `names` collects the declared names.
- `declarations` checks the declarations one by one, and `types` the expressions in them.
- `checks` examines the complete program. The package `tables` holds the built-in words of the language. `memo` stores results
  about parts of a program, for an editor that checks at every key press. No scene is read, so one program serves many scenes."""

from antdsl.program.checker import check

__all__ = ["check"]
