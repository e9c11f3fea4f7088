"""Arithmetic that gives the same bits on every processor: the lowest package of the runtime.

NumPy, libm and BLAS choose instructions at run time, and the last bits of their results depend on this choice. So this package
computes all values that affect a simulation's state. It uses only float64 sums, products, quotients, square roots and
rounding, in a fixed order.

- `elementary`: sin, cos, exp, log, pow and atan2
- `exact_sums`: sums that do not depend on the order of their terms
- `randomness`: random numbers that depend only on seed, frame, species, site and id
- `vectors`: vectors as three arrays; `vector_rows`: vectors as arrays (n, 3)
- `elementwise`: the table of elementwise operations in plans, which all backends use
- `kernel_vectors`, `elementary_loops`: functions for kernels
- `parallel`: runs kernels in parallel chunks"""
