"""What pages show of a session, and the messages about it."""
