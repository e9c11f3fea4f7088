"""From steering forces to positions: what the phase `move` does with all agents at once.

`advance` is the order of a substep. `strides` has its two loops over all agents, `velocities` what happens to velocity and
heading before and after the walk, `obstacles` what shortens a step. `rises` finds walls ahead, and `tilting` turns bodies after
the ground under their feet, with heads (`heads`) out of walls. `orienting` says what bodies stand across where a scene asks for
something else than the ground's normal. `falling` lets those drop whose ground was dug away; `moving_geometry` carries agents
with things that move; `walks` leads those whom the scene leads. `contacts` parts bodies that overlap, once all species have
walked: `capsules` and `capsule_distances` measure pairs, `cutting` cuts steps into others, `separation` parts pairs,
`corrections` walks what parting asks for and says for which agents that is not enough."""
