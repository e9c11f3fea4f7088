"""Shapes of agents, food and nests: small procedural meshes; and the collision capsules of trunks."""
