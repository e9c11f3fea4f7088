"""Moves agents: turns steering forces into positions. The phase `move` processes all agents together, with these modules.

- `crowd_substep` runs the stages of a substep in order. `substep_kernels` has its two loops over all agents.
- `velocities` updates velocity and heading before and after the walk. `obstacles` shortens steps at obstacles.
- `tilting` aligns bodies with the ground under their feet. `clearance` keeps bodies outside the ground.
- `orienting` chooses the up of a body if the scene requests another one than the ground's normal.
- `crouching` lowers bodies below low ceilings, and undoes steps to positions where the ceiling is too low.
- `falling` limits the fall of agents after their ground was dug away.
- `moving_geometry` carries agents with moving things. `scripted_walks` moves agents that the scene guides.
- `contacts` separates overlapping bodies after all species have walked. `correction_walks` moves agents by the resulting
  displacements, and finds the agents that still overlap."""
