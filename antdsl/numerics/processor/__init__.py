"""Queries the machine that a process runs on: the available cores and memory, and the floating-point environment of a thread."""
