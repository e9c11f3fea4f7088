"""Arithmetic that gives the same bits on every processor: the lowest package of the runtime.

NumPy, libm and BLAS choose instructions at run time, and their last bits depend on the choice. So everything that reaches a state
is computed here from float64 sums, products, quotients, roots and roundings in one fixed order.

`elementary` has sin, cos, exp, log, pow and atan2, `exact_sums` sums that do not depend on the order of their terms. In
`randomness`, a random number is a function of seed, frame, species, site and id. `vectors` uses three arrays, `vector_rows`
arrays (n, 3). `elementwise` is the table of the plan's elementwise operations, which both backends call. `kernel_vectors` and
`elementary_loops` are for kernels; `parallel` runs these in parallel chunks."""
