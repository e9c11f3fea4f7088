"""The types of expressions: dimension, kind and rate, and the findings about them.

`rules` maps each node to the function that types it. `expressions` has literals and names, `operators` operators, `calls` and
`arguments` calls. `sets` has sets and reductions over them, `states` questions about states, `aggregates` expressions that only
specs can use. `folding` does arithmetic on constants. `descriptions` has shared texts of findings."""
