"""Measurements between agents: the cell grid, and the senses and measures that use it.

`neighbours` sorts positions into cells and returns pairs (query, neighbour) within a radius, in the order of ids. Thus no
    result depends on rows or chunks. `touching` returns every pair of bodies that may touch once. `overlaps` measures how far
    bodies overlap. Rays, curves and surfaces that agents sense are in `casting`, `ground` and `fields`. A table in
    `runtime.sensing` maps plan operations to these functions."""
