"""Machine code made while a program runs, the same on every run: text in LLVM's language → functions in memory.

Below all rooms that calculate. `lanes` are values of eight agents at once, `emitter` writes functions of them, `meanings` says
what NumPy's functions do to them, `entries` writes functions that are called from outside. `machine` has LLVM make code of a
text, `codes` gives the code of a text, in memory or from another run (`object_cache`), and `memory` says where arrays lie."""
