"""The crowd lines of a scene: how many agents they create, when, where, and with which values the agents start."""
