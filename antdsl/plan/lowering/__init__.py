"""From the checked program to the plan: scalar nodes, statements over them, registers for each agent.

`lower` goes species by species, then fields, items and params. `machines`, `actions`, `birth` and `blending` write statements
into blocks (`writer`), `expressions` and `sets` turn typed expressions into nodes, with one function for each operation in
`rules`. `builder` makes the nodes: it checks operands against the table of `plan.ir`, folds constants by `simplify`, and gives
the same object for the same operation. `source_map` notes which nodes stand for which part of the text, for `explain`;
`spec_blocks` lowers what specs ask. Vectors become three nodes here, so nothing behind this room knows vectors."""
