"""The machine that a process runs on: the resources available to the process, and the floating-point environment of a thread."""
