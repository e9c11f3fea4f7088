"""What agents perceive and stand on: neighbours, rays, ground and curves, as array engines that know nothing of the plan."""
