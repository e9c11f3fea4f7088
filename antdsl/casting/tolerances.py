"""Tolerances: the effect of rounding on a crossing, and lengths that are too short to resolve."""

EDGE_WEIGHT_TOLERANCE = 1e-9  # weight by which a crossing may lie outside of a face, so that none is lost between two of them
TOUCHING_DISTANCE_MM = 1e-6  # mm: nearer than this to a face, it is the face itself that says which way is out
MIN_VECTOR_LENGTH = 1e-30  # of a vector of float32: a shorter one points nowhere
ROUNDING_BOUND = 1e-4  # relative, and in mm: more than any rounding of a place or a direction

NO_FACE, FACE_BEYOND_GRID = -1, -2  # instead of a face: there is none, and the grid cannot tell
# Of a search within a distance: the nearest is farther and faces the place, and that is not known
NEAREST_BEYOND_RANGE, NEAREST_UNKNOWN = -3, -4
MAX_RAY_CUBES = 16.0  # cubes along the three axes that a ray passes: of longer ones, thousands at once are faster in a tree
MAX_SEARCH_RINGS = 4  # of cubes around a place in which its nearest face is looked for
