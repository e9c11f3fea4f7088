"""A definition out of the arrays that `packed` makes, with all checks of a definition as a whole."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl.bodies.agents.definition import BodyError, Definition
from antdsl.bodies.agents.definition_checks import whole
from antdsl.bodies.agents.definition_document import Parts
from antdsl.bodies.agents.packed import read_packed
from antdsl.diagnostics import Report


def unpacked(arrays: Mapping[str, NDArray[Any]]) -> Definition:
    """The definition that `packed` made these arrays of. Raises BodyError for any others: nothing in them is trusted."""
    found, report = read_packed(arrays), Report()
    with np.errstate(all="ignore"):
        if whole(Parts(found, measured=False), report) is None:
            raise BodyError(f"is damaged: of a body, {report.errors[0].message}")
    return found
