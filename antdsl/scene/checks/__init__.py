"""Checks of a scene against its program. `scene_checks` runs them."""
