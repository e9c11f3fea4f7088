"""The crowd lines of a scene: how many agents they create, when and where, and the values with which agents start."""
