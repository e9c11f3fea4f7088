"""What reads USD files, in the process of the reader only: usd-core is imported here, and answers are numbers and texts.

`layer` reads one file, `stage` opens those that belong together, `requests` answers for what is at a prim."""
