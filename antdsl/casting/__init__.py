"""Raycasts and nearest-point queries on triangles, and related geometry. Only this package imports Open3D.

Inputs are vertices (mm) and triangles. Results are faces, distances and barycentric weights in float64.

- `rays`: Open3D finds a face, and `faces` recomputes the hit on it in float64, so that every processor gives the same results.
- `picture_rays`: returns Open3D's results unchanged, for pictures only.
- `triangle_grid`: answers queries of short rays (`grid_rays`) and of the nearest face (`nearest_faces`) without Open3D. It tests
  all nearby faces in float64.
- `ray_walks`: rays that start near a known face, which need no search.
- `distance_grid`: lower bounds of distances. Rays that are shorter than the bound, which are most, need not be cast.
- `rasterise`: the cells of a lattice that triangles touch.
- `curves`: polylines with queries of nearest points.
- `lamps`: spheres that emit light.

The package does not depend on agents, plans or scenes."""
