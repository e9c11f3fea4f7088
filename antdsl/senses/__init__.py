"""Measurements between agents, such as who is near and which bodies touch. They share one cell grid.

`neighbours` sorts positions into cells and returns pairs (query, neighbour) within a radius, in the order of ids. Thus no
result depends on rows or chunks. `touching` returns all pairs of bodies that may touch, each pair once. `overlaps` measures
how far bodies overlap. Queries of rays, curves and surfaces are in `casting`, `ground` and `fields`. A table in
`runtime.sensing` maps plan operations to these functions."""
