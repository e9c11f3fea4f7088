"""Crowd lines of a scene: how many agents, when, where, and with which values they begin."""
