"""The backends that run a plan's blocks, by name in BACKENDS. Their results are bit-identical.

`reference` runs one agent and one operation at a time, in plain Python. It defines the language, and `explain` uses it.

`numpy_backend` runs a block over all agents of a species. `block_compiler` converts each block once into lists of instructions on
slots, which hold values. `numpy_calls` and `numpy_statements` turn each instruction into a function call. A conditional part runs
only for the rows where its condition holds.

`native` compiles the same lists to machine code. NumPy runs the blocks until the code is ready.

All backends take elementwise operations from one table (`numerics.elementwise`), sums over sets are exact, and random draws
depend only on the agent's id. So results do not depend on row order, chunks or threads. A backend fills an `EffectRequests`; the
phases of the step apply it."""

from collections.abc import Callable, Mapping

from antdsl.plan import ir
from antdsl.runtime.backends.native import NativeBackend
from antdsl.runtime.backends.numpy_backend import NumpyBackend
from antdsl.runtime.backends.reference import ReferenceBackend
from antdsl.runtime.world import StepBackend

BACKENDS: Mapping[str, Callable[[ir.Plan], StepBackend]] = {
    "numpy": NumpyBackend,  # complete arrays
    "native": NativeBackend,  # machine code, eight agents at a time
    "reference": ReferenceBackend,  # one agent at a time; defines the language
}

__all__ = ["BACKENDS", "NativeBackend", "NumpyBackend", "ReferenceBackend"]
