"""From steering forces to places: what the phase `move` does with all agents at once.

`advance` is the order: acceleration, limits of speed and turn, `obstacles` that shorten a step, the ground's own move,
headings. `falling` lets those drop whose ground was dug away; `moving_geometry` carries agents with things that move;
`tilting` turns bodies after the ground under their feet, with `rises` and `heads` keeping heads out of what rises before them.
`orienting` says what bodies stand across where a scene asks for something else than the ground's normal.
`walks` leads those whom the scene leads. `contacts` parts bodies (`capsules`) that stand in each other, once all species have
walked: `cutting` cuts steps into others, `corrections` walks what parting asks for, `rounds` says for whom that is not
enough. `clearances` tells how far everybody is from obstacles, at least, so that few have to ask with rays."""
