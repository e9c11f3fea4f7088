"""Readers of USD files that run only in the reader process. They import usd-core, and answer with numbers and texts.

`stage` opens one file and the files that it consists of. `requests` answers requests about the contents of a prim."""
