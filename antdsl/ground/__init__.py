"""Grounds that agents stand on: meshes, moving meshes, solids that can be dug, all of these together, or an endless plane.

The runtime uses one interface, a ground. It returns the positions of footings, the direction up at a footing, and the result of a
step.

- `mesh`: walks over triangles
- `moving`: meshes that move between steps
- `solid`: signed distance fields that can be dug
- `combined`: joins meshes and solids
- `plane`: the ground of a scene without surfaces
- `sticking`: follows any surface by two rays per step

A footing is a row of a table, on any ground (`Footing`). Positions and lengths are in mm, in the scene's axes."""
