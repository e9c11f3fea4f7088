"""A cache of data computed from meshes, for later worlds. Its keys are digests of the inputs.

It pays because meshes seldom change when a program is edited, and preparing a ground with its rays and cells takes longer than a
step."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from copy import deepcopy
from dataclasses import fields, is_dataclass
from hashlib import sha256
from typing import Any, TypeVar

import numpy as np

CachedValue = TypeVar("CachedValue")


class BindingCache:
    """A cache of grounds, ray scenes, cells, volumes and flows, all in their initial state.

    Data that changes during a run, such as diggable or moving things, is returned as a copy."""

    def __init__(self) -> None:
        self._values: dict[str, Any] = {}
        self._used_keys: set[str] = set()

    def get_or_compute(
        self,
        kind: str,
        inputs: object,
        make: Callable[[], CachedValue],
        *,
        copy_value: Callable[[CachedValue], CachedValue] | None = None,
    ) -> CachedValue:
        """Return the result of `make`, or a cached result for equal `inputs`.

        `inputs`: any combination of arrays, numbers and texts. `copy_value`: copies a result before it is returned; None for no
        copy. An exception of `make` propagates, and nothing is cached."""
        key = compute_digest((kind, inputs))
        self._used_keys.add(key)
        if key not in self._values:
            self._values[key] = make()
        product: CachedValue = self._values[key]
        return product if copy_value is None else copy_value(product)

    def get_or_compute_deep_copy(self, kind: str, inputs: object, make: Callable[[], CachedValue]) -> CachedValue:
        """Return a deep copy of the new or cached result of `make`. Use it for values that change during a run."""
        return self.get_or_compute(kind, inputs, make, copy_value=deepcopy)

    def drop_unused_values(self) -> None:
        """Remove all values that were not used since the last call of this method."""
        self._values = {key: value for key, value in self._values.items() if key in self._used_keys}
        self._used_keys = set()


def compute_digest(value: object) -> str:
    """Return a hash of the content of a value, which may consist of arrays, numbers, texts, mappings, sequences and
    dataclasses."""
    hashed = sha256()
    _add_to_digest(hashed.update, value)
    return hashed.hexdigest()


def _add_to_digest(update: Callable[[bytes], None], value: object) -> None:
    """Pass the content of a value to `update`, with markers for types and lengths."""
    if isinstance(value, np.ndarray):
        update(f"a{value.dtype.str}{value.shape}".encode())
        update(np.ascontiguousarray(value).tobytes())
    elif is_dataclass(value) and not isinstance(value, type):
        update(f"d{type(value).__name__}".encode())
        for each in fields(value):
            _add_to_digest(update, getattr(value, each.name))
    elif isinstance(value, Mapping):
        update(f"m{len(value)}".encode())
        for key, inner in value.items():
            _add_to_digest(update, key)
            _add_to_digest(update, inner)
    elif isinstance(value, tuple | list):
        update(f"t{len(value)}".encode())
        for inner in value:
            _add_to_digest(update, inner)
    else:
        update(f"{type(value).__name__}:{value!r};".encode())
