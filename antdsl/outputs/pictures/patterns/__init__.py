"""Patterns of surfaces in pictures: points → values of solid noise. `noise` has the loops and their tables."""
