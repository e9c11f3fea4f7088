"""One module for each command: its flags, a call into the pipeline, printing and an exit code."""
