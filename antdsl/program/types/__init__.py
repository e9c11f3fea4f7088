"""What an expression is: its dimension, kind and rate, and the complaints about it.

`rules` says which function gives the type of which node. `expressions` has literals and names, `operators` signs and words
between values, `calls` and `arguments` calls, `sets` sets and what is reduced over them, `states` questions about states,
`aggregates` what only a spec can ask. `folding` does arithmetic on constants. `descriptions` has the words of complaints that
several share."""
