"""Tolerances: the effect of rounding on a crossing, and lengths that are too short to resolve."""

CLOSED = 1e-9  # weight by which a crossing may lie outside of a face, so that none is lost between two of them
TOUCHING = 1e-6  # mm: nearer than this to a face, it is the face itself that says which way is out
SHORTEST = 1e-30  # of a vector of float32: a shorter one points nowhere
FAR_OFF = 1e-4  # relative, and in mm: more than any rounding of a place or a direction

NOTHING, FURTHER = -1, -2  # instead of a face: there is none, and the grid cannot tell
BEYOND, UNSURE = -3, -4  # of a search within a distance: the nearest is farther and faces the place, and that is not known
LONGEST = 16.0  # cubes along the three axes that a ray passes: of longer ones, thousands at once are faster in a tree
RINGS = 4  # of cubes around a place in which its nearest face is looked for
