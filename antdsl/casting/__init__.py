"""Rays and nearest points against triangles, and the geometry that uses them: the only package that imports Open3D.

Inputs are vertices and triangles in mm; outputs are faces, distances and weights in float64. `rays` takes the face from Open3D,
and `faces` measures it again in float64, so that no result depends on the processor. `picture_rays` uses Open3D's values
directly, for pictures only. `triangle_grid` computes short rays (`grid_rays`) and near points (`nearest_faces`) without Open3D:
all nearby faces in float64. `distance_grid` gives lower bounds of distances, so most rays are never cast. `rasterise` finds the
cells of a lattice that triangles touch; `curves` are polylines with nearest points. Nothing here depends on agents, plans or
scenes."""
