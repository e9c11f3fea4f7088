"""Lowers the checked program to the plan: scalar nodes, the statements that use them, and registers for each agent.

- `lower`: lowers each species, then fields, items and params.
- `machines`, `actions`, `birth`, `blending`: write statements into blocks (`writer`).
- `expressions`, `sets`: turn typed expressions into nodes, with one function for each operation in `rules`.
- `builder` (in `plan`): makes the nodes, checks operands against the table of `plan.ir`, folds constants, and returns one object
  for equal operations.
- `source_map`: records which nodes belong to each part of the source text, for `explain`.
- `spec_blocks`: lowers specs.

Vectors become three nodes here, so code that reads plans needs no vectors."""
