"""Determines the types of expressions (their dimension, kind and rate), and reports errors.

- `rules`: maps each node class to the function that types it.
- `expressions`: literals and names. `operators`: operators. `calls`, `arguments`: calls.
- `sets`: sets and reductions over them. `states`: questions about states.
- `aggregates`: expressions that only specs can use.
- `folding`: arithmetic on constants. `descriptions`: texts that several findings share."""
