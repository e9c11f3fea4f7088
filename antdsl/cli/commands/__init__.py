"""One module per command. Each defines its flags, calls the pipeline, prints, and sets the exit code."""
