"""From steering forces to positions: the steps by which the phase `move` processes all agents together.

- `crowd_substep` runs the stages of a substep in order. `substep_kernels` has its two loops over all agents.
- `velocities` updates velocity and heading before and after the walk. `obstacles` shortens steps at obstacles.
- `walls_ahead` finds walls ahead. `tilting` aligns bodies with the ground under their feet. `head_clearance` finds heads inside
  the ground.
- `orienting` chooses the up of a body if the scene requests another one than the ground's normal.
- `falling` limits the fall of agents after their ground was dug away.
- `moving_geometry` carries agents with moving things. `scripted_walks` moves agents that the scene guides.
- `contacts` separates overlapping bodies after all species have walked. `capsules` and `capsule_distances` measure pairs,
`step_clamping` shortens steps into other agents, and `separation` separates pairs. `correction_walks` walks the resulting
displacements and returns the agents for which they were not enough."""
