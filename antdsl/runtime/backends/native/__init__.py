"""The native backend. It compiles a block's vectorised instructions to machine code that processes eight agents at a time."""

from antdsl.runtime.backends.native.native_backend import NativeBackend

__all__ = ["NativeBackend"]
