"""Raycasts and nearest-point queries on triangles, and related geometry. Only this package imports Open3D.

Input is vertices and triangles in mm; output is faces, distances and weights in float64.

- `rays`: Open3D finds a face, and `faces` recomputes the hit on it in float64, so that results are the same on every processor.
- `picture_rays`: Open3D's results as they are, for pictures only.
- `triangle_grid`: answers short rays (`grid_rays`) and queries near faces (`nearest_faces`) without Open3D, from all nearby
  faces in float64.
- `ray_walks`: rays that start near a known face. They need no search.
- `distance_grid`: lower bounds of distances. Most rays are shorter than the bound and need not be cast.
- `rasterise`: the cells of a lattice that triangles touch.
- `curves`: polylines with nearest points.
- `lamps`: spheres that emit light.

The package does not depend on agents, plans or scenes."""
