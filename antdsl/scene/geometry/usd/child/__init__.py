"""Readers of USD files, which run only in the reader process. They import usd-core, and answer with numbers and texts.

`stage` opens one file and the files that belong to it. `requests` answers requests about the contents at a prim."""
