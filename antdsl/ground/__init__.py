"""Grounds that agents stand on: meshes, meshes that move, solids that can be dug, all of them together, or an endless plane.

The runtime uses one interface, a ground: the positions of footings, the direction up there, and where a step leads. `mesh` walks
over triangles. `moving` has meshes that move between steps. `solid` is a signed distance that can be dug. `combined` joins meshes
and solids. `plane` is the ground of a scene without surfaces. `sticking` follows any surface by two rays a step. A footing is a
row of one table on any ground (`footing_table`). Positions and lengths are in mm, in the scene's axes."""
