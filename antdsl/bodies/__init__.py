"""What agents, food and nests look like: small meshes made from numbers; and the capsules that trunks take room by."""
