"""Rays and nearest points against triangles, and the geometry that asks for them: the one room that imports Open3D.

In go vertices and triangles in mm; out come faces, distances and weights in float64. `rays` lets Open3D name a face, and
`faces` measures it again in float64, so that no result depends on the processor; `picture_rays` takes its word, for what is only
looked at. `triangle_grid` answers short rays (`grid_rays`) and near
places (`nearest_faces`) without it: all faces nearby in float64. Rays near a known face need no search (`ray_walks`).
`distance_grid` gives lower bounds of distances, by which most rays are never cast; `rasterise` tells which cells of a
lattice triangles touch; `curves` are polylines with nearest points. Nothing here knows agents, plans or scenes."""
