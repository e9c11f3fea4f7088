"""How a walk on a solid steps: lengths in voxels, and when a step is taken back."""

STRIDE = 1.0  # voxels of one step at most
LEAST = 1 / 128  # voxels of one step, below which there is no way on
OFF = 0.12  # voxels that the middle of a step may be off the surface: else an edge is cut, or a thin wall is passed
BACK = -0.25  # cosine of the turn of the normal in one step, below which another wall may have been met
FARTHER = 1.3  # lengths of one step that it may lead at most
EDGE = 0.1  # voxels of a step so short that a sharp turn is an edge and no other wall
NEWTON = 4
BISECTIONS = 24
DONE = 1e-6  # voxels of way left that are none
CROSSINGS = 400  # steps of one move
STANCE = 0.4  # of a body: how far around its place the normal that it stands by looks, each way
THIN = 0.1  # length of that gradient below which it says nothing: the normal of the place itself is taken
