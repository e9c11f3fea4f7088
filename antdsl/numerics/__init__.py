"""Arithmetic that gives the same bits on every processor: the lowest package of the runtime.

NumPy, libm and BLAS choose instructions at run time, and the last bits of their results depend on the choice. So all values
that affect a simulation's state are computed by this package. It uses float64 sums, products, quotients, roots and roundings
in one fixed order.

- `elementary`: sin, cos, exp, log, pow and atan2
- `exact_sums`: sums that do not depend on the order of their terms
- `randomness`: random numbers that are a function of seed, frame, species, site and id
- `vectors`: vectors as three arrays; `vector_rows`: vectors as arrays (n, 3)
- `elementwise`: the table of the plan's elementwise operations, which the backends call
- `kernel_vectors`, `elementary_loops`: functions for kernels
- `parallel`: runs kernels in parallel chunks"""
