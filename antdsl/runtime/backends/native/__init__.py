"""The native backend: a block's vectorised instructions become machine code, eight agents at a time."""

from antdsl.runtime.backends.native.native_backend import NativeBackend

__all__ = ["NativeBackend"]
