"""How a plan's blocks are run: BACKENDS by name. All give the same bits.

`reference` takes one agent at a time and one operation at a time, in plain Python: it is the definition of the language, and
what `explain` runs. `numpy_backend` runs a block over all agents of a species: `compile` turns the block into lists of
instructions over slots once, `numpy_calls` and `numpy_statements` make a call of each, and a condition becomes the rows where
it holds. `native` makes machine code of the same lists, and lets NumPy run until it is there. Elementwise operations are one
table for all (`numerics.elementwise`), sums over sets are exact, draws are functions of the id: no result depends on rows,
chunks or threads. A backend fills an `Effects`; the phases of the step apply it."""

from collections.abc import Callable, Mapping

from antdsl.plan import ir
from antdsl.runtime.backends.native import NativeBackend
from antdsl.runtime.backends.numpy_backend import NumpyBackend
from antdsl.runtime.backends.reference import ReferenceBackend
from antdsl.runtime.world import Backend

BACKENDS: Mapping[str, Callable[[ir.Plan], Backend]] = {
    "numpy": NumpyBackend,  # whole arrays: for work
    "native": NativeBackend,  # machine code, eight agents at a time: for speed
    "reference": ReferenceBackend,  # one agent at a time: the definition, and the one that explains
}

__all__ = ["BACKENDS", "NativeBackend", "NumpyBackend", "ReferenceBackend"]
