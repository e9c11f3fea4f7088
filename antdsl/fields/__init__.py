"""Values that live on surfaces: the cells of a surface and the pheromone in them."""
