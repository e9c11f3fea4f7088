"""How a plan's blocks are run: BACKENDS by name. Both give the same bits."""

from collections.abc import Callable, Mapping

from antdsl.plan import ir
from antdsl.runtime.backends.numpy_backend import NumpyBackend
from antdsl.runtime.backends.reference import ReferenceBackend
from antdsl.runtime.world import Backend

BACKENDS: Mapping[str, Callable[[ir.Plan], Backend]] = {
    "numpy": NumpyBackend,  # whole arrays: for work
    "reference": ReferenceBackend,  # one agent at a time: the definition, and the one that explains
}

__all__ = ["BACKENDS", "NumpyBackend", "ReferenceBackend"]
