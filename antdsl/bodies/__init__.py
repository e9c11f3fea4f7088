"""Bodies of agents (agent definitions and skinned meshes), and shapes of items such as food and nests (procedural meshes)."""
