"""Commands about the documentation."""
