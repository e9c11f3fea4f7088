"""What agents, food and nests look like: small meshes made from numbers."""
