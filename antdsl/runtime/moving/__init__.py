"""From steering forces to positions: the steps by which the phase `move` processes all agents together.

- `advance` runs the stages of a substep in order. `strides` has its two loops over all agents.
- `velocities` updates velocity and heading before and after the walk. `obstacles` shortens steps at obstacles.
- `rises` finds walls ahead. `tilting` aligns bodies with the ground under their feet. `heads` finds heads inside the ground.
- `orienting` chooses the up of a body if the scene requests another one than the ground's normal.
- `falling` limits the fall of agents after their ground was dug away.
- `moving_geometry` carries agents with moving things. `walks` moves agents that the scene guides.
- `contacts` separates overlapping bodies after all species have walked. `capsules` and `capsule_distances` measure pairs,
`cutting` shortens steps into other agents, and `separation` separates pairs. `corrections` walks the resulting displacements
and returns the agents for which they were not enough."""
