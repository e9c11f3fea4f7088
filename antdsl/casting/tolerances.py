"""Tolerances of ray hits: bounds of rounding errors, and lengths that are too short to resolve."""

EDGE_WEIGHT_TOLERANCE = 1e-9  # weight by which a hit may lie outside a face, so that no ray passes between two faces
TOUCHING_DISTANCE_MM = 1e-6  # mm; at a smaller distance the face's normal gives the direction out
MIN_VECTOR_LENGTH = 1e-30  # a shorter float32 vector has no direction
ROUNDING_BOUND = 1e-4  # relative, and in mm; exceeds any rounding of a position or a direction

NO_FACE, FACE_BEYOND_GRID = -1, -2  # results instead of a face: no face; the grid has no answer
# Results of a search within a distance: the nearest face is farther and faces the point; the grid has no answer
NEAREST_FACE_BEYOND_RANGE, NEAREST_FACE_UNKNOWN = -3, -4
MAX_RAY_CUBES = 16.0  # maximum number of cubes along a ray, summed over the axes; many longer rays are faster in a tree
MAX_SEARCH_RINGS = 4  # rings of cubes around a point that are searched for its nearest face
