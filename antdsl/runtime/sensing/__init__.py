"""The senses of agents at run time.

`world_senses` has one function per operation of the plan, `thing_senses` the functions for curves, flows, maps and cameras,
and `lamp_light` the one for lamps. `pairs`, `item_pairs` and `nearest_pairs` find agents and items near agents, with the grids
of `neighbourhood`.  `sensed_camera` gives the position of a camera, and `selectable_agents` the arrays that selectors read."""
