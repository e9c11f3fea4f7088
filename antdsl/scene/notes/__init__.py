"""Notes of a scene: their models, the selectors that name agents, and the checks of both against the programs."""
