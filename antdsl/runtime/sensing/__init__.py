"""The senses of agents at run time.

`world_senses` has one function for each operation of the plan. Functions for curves, flows, maps and cameras are in
`thing_senses`, and the function for lamps is in `lamp_light`. `pairs`, `item_pairs` and `nearest_pairs` find agents and items
near agents, with the grids of `neighbourhood`. `sensed_camera` gives the position of a camera, and `selectable_agents` the arrays
that selectors read."""
