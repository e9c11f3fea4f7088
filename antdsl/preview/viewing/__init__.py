"""What pages are shown of a session, and told about it."""
