"""Quantities defined on surfaces or in space: pheromone, flows, maps and costs.

`cells` divides surfaces into cells of one size. `growing` adds cells for dug walls (`runtime.digging` requests them).
`pheromone` deposits amounts in cells, evaporates, diffuses and senses them. Deposits are fixed-point numbers, so their order
does not matter. `threshold_cells` finds the cells near which a field is at least as strong as a threshold. `flow` interpolates
vectors and painted numbers at the footings of agents, from the points of `face_points`. `path_flow` makes a flow along the
cheapest path to a goal, from the path costs of `path_cost`."""
