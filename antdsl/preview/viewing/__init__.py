"""The display of a session on pages, and the messages about it."""
