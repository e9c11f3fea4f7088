"""Values that lie on surfaces or in space: pheromone, flows, maps and costs.

`cells` cuts surfaces into cells of one size, `growing` gives dug walls cells of their own (`runtime.digging` makes them).
`pheromone` is laid in cells, fades, spreads and is sensed; deposits are added in fixed point, so their order does not count;
`reached` knows around which cells there is as much as a number.
`flow` reads vectors and painted numbers by footing at the points of `face_points`; `solved` makes a flow that leads the cheapest
way to a goal from the field of costs of `cost`."""
