"""Notes of a scene: their models, the selectors that name agents, and checks of notes and selectors against the programs."""
