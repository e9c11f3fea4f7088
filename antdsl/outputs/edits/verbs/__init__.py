"""The edits: one `EditLayer` and one model of its line for each verb."""
