"""From steering forces to positions: what the phase `move` does with all agents at once.

`advance` runs the stages of a substep in order. `strides` has its two loops over all agents, `velocities` updates velocity and
heading before and after the walk, and `obstacles` shortens steps at obstacles. `rises` finds walls ahead. `tilting` aligns bodies
with the ground under their feet, with heads (`heads`) out of walls; `orienting` chooses the axis where a scene sets another one
than the ground's normal. `falling` drops agents after their ground was dug away, `moving_geometry` carries agents with things
that move, and `walks` moves agents that the scene guides. `contacts` separates bodies that overlap, once all species have walked:
`capsules` and `capsule_distances` measure pairs, `cutting` shortens steps into other agents, `separation` separates pairs, and
`corrections` walks the displacements and returns for which agents they are not enough."""
