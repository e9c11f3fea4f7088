"""Machine code that is built at run time and is the same on every run: text in LLVM's language → functions in memory.

This package is below all packages that compute.

- `kernels`: the instructions, their table and their verifier; it translates Python loops to instructions.
- `lanes`: builds the same instructions for the values of eight agents at once, with the types of `number_kinds`.
- `llvm_module`: the texts of functions; `entry_functions` writes the functions that are called from outside.
- `llvm_compiler`: compiles a text with LLVM.
- `code_cache`: returns the code of a text: from memory, the installation (`shipped_objects`) or an earlier run (`object_cache`),
  or compiled
  now.
- `library`: all kernels and texts of the package, which `build_objects` compiles on installation.
- `memory`: padding and addresses of arrays."""
