"""Determines the types of expressions (dimension, kind and rate), and reports type errors.

- `rules`: maps each node class to the function that types it.
- `expressions`: literals and names. `operators`: operators. `calls`, `arguments`: calls.
- `sets`: sets and reductions over them. `states`: expressions about states and clips.
- `aggregates`: expressions that only specs can use.
- `folding`: arithmetic on constants. `descriptions`: texts that several findings share."""
