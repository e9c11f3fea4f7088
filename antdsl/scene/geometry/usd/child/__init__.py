"""What reads USD files, in the process of the reader only: usd-core is imported here, and nothing of it is in an answer but numbers
and texts. `layer` reads one file, `stage` opens those that belong together, `requests` answers for what lies at a prim."""
