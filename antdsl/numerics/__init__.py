"""Arithmetic that gives the same bits on every processor: the lowest room of the run time.

NumPy, libm and BLAS choose instructions when they run, and their last bits change with them. So everything that reaches a state
is made here of float64 sums, products, quotients, roots and roundings in one fixed order: `elementary` (sin, cos, exp, log, pow,
atan2), `exact_sums` (sums that do not depend on the order of their terms), `randomness` (a random number is a function of seed,
frame, species, site and id), `vectors` (three arrays) and `vector_rows` (arrays (n, 3)). `elementwise` is the table of the plan's
elementwise operations, which both backends call. `kernel_vectors` and `elementary_loops` are for kernels; `parallel` runs these
in parallel chunks."""
