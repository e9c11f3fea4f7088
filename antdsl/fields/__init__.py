"""Quantities defined on surfaces or in space: pheromone, flows, maps and costs.

`cells` divides surfaces into cells of one size. `growing` adds cells for walls that agents dig (`runtime.digging` requests
them). `pheromone` stores amounts in cells: agents deposit and sense them; they evaporate and diffuse. Deposits are added as
fixed-point numbers, so their order does not matter. `threshold_cells` finds the cells near which a field reaches a threshold.
`flow` interpolates vectors and painted numbers at the footings of agents, between the lattice points of `face_points`.
`path_flow` makes a flow along the cheapest path to a goal, with path costs from `path_cost`."""
