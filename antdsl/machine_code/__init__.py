"""Machine code that is built at run time, the same on every run: text in LLVM's language → functions in memory.

This package is below all packages that compute. `kernels` has the instructions, their table and their verifier, and translates
Python loops to them. `lanes` builds the same instructions for values of eight agents at once, typed by `kinds`. A `module` holds
the texts of functions, and `entries` writes those that are called from outside. `machine` compiles a text with LLVM. `codes`
returns the code of a text: from memory, the installation (`shipped`) or an earlier run (`object_cache`), or compiled now.
`library` has all kernels and texts of the package, which `build_objects` compiles on installation. `memory` deals with the
addresses of arrays."""
