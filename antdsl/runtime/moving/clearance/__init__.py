"""Keeps bodies outside the ground, obstacles and solids.

`clear_steps` runs the stages of a substep, `body_tables` has its inputs, and `clearance_kernels` its loops. `body_paths`,
`body_lifts` and `walls_ahead` measure the ground along the path. `obstacle_clearance` bounds the distance from obstacles and
packs their faces. `solid_clearance` shifts bodies out of solids. `bodies_inside` and `head_clearance` find what is inside the
ground."""
