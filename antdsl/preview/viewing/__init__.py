"""The packets and messages that display a session on pages."""
