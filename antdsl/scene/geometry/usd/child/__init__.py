"""What reads USD files, in the process of the reader only: usd-core is imported here, and answers are numbers and texts.

`stage` reads one file and opens those that belong together, `requests` answers for what is at a prim."""
