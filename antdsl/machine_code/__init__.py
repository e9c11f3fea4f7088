"""Compiles LLVM IR to functions in memory at run time. The machine code is the same on every run.

This package is below all packages that compute.

- `kernels`: the instructions, their table and their verifier; it translates Python loops to instructions.
- `lanes`: builds the same instructions for the values of eight agents at once, with the types of `number_kinds`.
- `llvm_module`: the LLVM IR of functions; `entry_functions` writes the functions that callers outside the module use.
- `llvm_compiler`: compiles LLVM IR.
- `code_cache`: returns the machine code for a piece of LLVM IR. The code is in memory, in the installation
  (`shipped_objects`), stored by an earlier run (`object_cache`), or compiled now.
- `library`: all kernels and LLVM IR texts of the package; `build_objects` compiles them during installation.
- `memory`: padding and addresses of arrays."""
