"""The machine a process runs on: what it grants the process, and the floating-point environment of a thread."""
