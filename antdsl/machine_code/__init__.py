"""Machine code made while a program runs, the same on every run: text in LLVM's language → functions in memory.

Below all rooms that calculate. `lanes` are values of eight agents at once, `emitter` writes functions of them, `meanings` says
what NumPy's functions do to them, `entries` writes functions that are called from outside. `machine` has LLVM make code of a
text. `codes` gives the code of a text: from memory, from the installation (`shipped`), from an earlier run (`object_cache`), or
compiled now. `library` has all kernels and texts of the package, which `build_objects` compiles on installation. `memory` says
where arrays lie."""
