"""Rays and nearest points against triangles, and the geometry of these queries. Only this package imports Open3D.

Input is vertices and triangles in mm; output is faces, distances and weights in float64.

- `rays`: Open3D proposes a face, and `faces` measures it again in float64, so that no result depends on the processor.
- `picture_rays`: Open3D's results without that check, for pictures only.
- `triangle_grid`: answers short rays (`grid_rays`) and queries near faces (`nearest_faces`) without Open3D, from all nearby faces
  in float64.
- `ray_walks`: rays near a known face, which need no search.
- `distance_grid`: lower bounds of distances; with them, most rays need not be cast.
- `rasterise`: the cells of a lattice that triangles touch.
- `curves`: polylines with nearest points.
- `lamps`: spheres that emit light.

The package does not depend on agents, plans or scenes."""
