"""The edits. Each verb has an `EditLayer`, and a model of its line."""
