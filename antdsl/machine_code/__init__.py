"""Machine code made while a program runs, the same on every run: text in LLVM's language → functions in memory.

Below all rooms that calculate. `kernels` has the instructions, their table and their verifier, and makes them of loops in Python.
`lanes` makes the same instructions of values of eight agents at once, of `kinds`; a `module` has the texts of functions, and
`entries` writes those that are called from outside. `machine` has LLVM make code of a
text. `codes` gives the code of a text: from memory, from the installation (`shipped`), from an earlier run (`object_cache`), or
compiled now. `library` has all kernels and texts of the package, which `build_objects` compiles on installation. `memory` says
where arrays lie."""
