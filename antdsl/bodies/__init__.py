"""Bodies of agents and shapes of food, nests and other items: agent definitions, small procedural meshes, and skinned meshes."""
