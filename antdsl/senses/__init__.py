"""Agents near agents: the cell grid and what is measured with it.

`neighbours` sorts positions into cells and answers with pairs (query, neighbour) within a radius, in the order of ids, so that
no result depends on rows or chunks. `touching` gives every pair once whose bodies may touch.
`overlaps` measures how far bodies stand inside each other. Rays, curves and surfaces that
agents sense are in `casting`, `ground` and `fields`; which operation of the plan asks which of them is a table in
`runtime.sensing`."""
