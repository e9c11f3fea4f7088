"""The grounds that agents stand on: meshes, moving meshes, solids that can be dug, combinations of these, or an infinite plane.

The runtime uses all of them through one interface, `Ground`. It gives the positions and normals of footings, and the results of
steps.

- `mesh`: walks over triangles
- `moving`: meshes that move between steps
- `solid`: signed distance fields that can be dug
- `combined`: joins meshes and solids
- `plane`: the ground of a scene without surfaces
- `sticking`: keeps agents on any surface by two rays per step

On every ground, a footing is a row of a table (`Footing`). Positions and lengths are in mm, in the scene's axes."""
