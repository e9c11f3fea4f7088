"""Moves agents: turns steering forces into positions. The phase `move` processes all agents together, in these steps.

- `crowd_substep` runs the stages of a substep in order. `substep_kernels` has its two loops over all agents.
- `velocities` updates velocity and heading before and after the walk. `obstacles` shortens steps at obstacles.
- `tilting` aligns bodies with the ground under their feet. `clearance` holds bodies outside the ground.
- `orienting` chooses the up of a body if the scene requests another one than the ground's normal.
- `crouching` lowers bodies below low ceilings, and undoes steps to places that are too low.
- `falling` limits the fall of agents after their ground was dug away.
- `moving_geometry` carries agents with moving things. `scripted_walks` moves agents that the scene guides.
- `contacts` separates overlapping bodies after all species have walked. `correction_walks` walks the resulting displacements
  and returns the agents for which they were not enough."""
