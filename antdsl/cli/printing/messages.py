"""The output streams of the terminal.

A command finishes its work even if standard output or standard error is closed, full, broken or slow, or its encoding lacks a
character."""

from __future__ import annotations

import errno
import io
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Any, TextIO

# The reader has gone, or the caller closed the stream: the text is discarded, as by /dev/null.
_CLOSED_READER_ERRORS = frozenset(
    (errno.EPIPE, errno.EBADF, errno.EIO, errno.ENXIO, errno.ECONNRESET, errno.ESHUTDOWN, errno.EINVAL)
)
_MAX_BACKLOG_BYTES = 8 << 20  # bytes of notes queued for a slow reader; further notes are dropped
_PIPE_BLOCK_BYTES = 512  # a ready pipe takes at least this number of bytes without blocking


class TerminalWriter(io.RawIOBase):
    """The raw stream behind standard output or standard error. Writing to it never raises OSError.

    Results wait for a slow reader. Notes do not: they are stored in a backlog while the work continues, until `close_streams`.
    `loss_reason`: why a part of a result could not be written; None if everything was written, or if nothing reads the stream.
    """

    def __init__(self, raw: Any) -> None:
        self.raw = raw
        self.is_note = False
        self.has_no_reader = False
        self.loss_reason: OSError | None = None
        self.backlog = bytearray()

    def write(self, data: Any) -> int:
        """Write all of the data, or record why this is impossible. In both cases, return the length of the data in bytes."""
        view = memoryview(data).cast("B")
        if self.has_no_reader:
            return len(view)
        if not self.is_note:
            self.flush_backlog()
            self._send(view)
        elif len(self.backlog) + len(view) <= _MAX_BACKLOG_BYTES:
            self.backlog += view
            while self.backlog and self._can_write():
                self._send_backlog(_PIPE_BLOCK_BYTES)
        return len(view)

    def flush_backlog(self) -> None:
        """Write everything in the backlog. Wait for the reader if necessary."""
        if self.backlog:
            self._send_backlog(len(self.backlog))

    def _send_backlog(self, size: int) -> None:
        """Write the first `size` bytes of the backlog and remove them from it."""
        block = bytes(self.backlog[:size])
        del self.backlog[:size]
        self._send(memoryview(block), is_note=True)

    def _send(self, view: memoryview, is_note: bool = False) -> None:
        while view:
            try:
                count = self.raw.write(view)
            except OSError as problem:
                if problem.errno in (errno.EAGAIN, errno.EWOULDBLOCK):
                    count = None
                elif problem.errno in _CLOSED_READER_ERRORS:
                    self.has_no_reader = True
                    self.backlog.clear()
                    return
                else:
                    if not is_note:
                        self.loss_reason = problem
                    return
            if count is None:  # the stream does not block, and its reader is slow
                self._can_write(1000)
            else:
                view = view[count:]

    def _can_write(self, milliseconds: int = 0) -> bool:
        """Return whether a small write is possible without blocking. `milliseconds`: how long to wait for this."""
        import select

        if not hasattr(select, "poll"):
            return True
        poll = select.poll()
        poll.register(self.raw.fileno(), select.POLLOUT)
        return bool(poll.poll(milliseconds))

    def writable(self) -> bool:
        return True

    def fileno(self) -> int:
        return int(self.raw.fileno())

    def isatty(self) -> bool:
        return bool(self.raw.isatty())


def guard_streams() -> None:
    """Make it safe to write to the streams of this process. Call this once, before any file is opened.

    A closed stream is opened on /dev/null. So no other file gets its descriptor, and child processes do not inherit a closed
    stream.
    """
    for number in range(3):
        _open_null_stream(number)
    if hasattr(os, "set_blocking"):
        with suppress(OSError):
            os.set_blocking(0, True)  # otherwise a reader treats "nothing yet" as the end
    if sys.stdin is None:
        sys.stdin = open(0, encoding="utf-8", closefd=False)  # noqa: SIM115 - open until the process ends
    for number, name in ((1, "stdout"), (2, "stderr")):
        stream = getattr(sys, name)
        encoding = "utf-8" if stream is None else stream.encoding
        raw = io.FileIO(number, "w", closefd=False) if stream is None else getattr(stream.buffer, "raw", stream.buffer)
        terminal = TerminalWriter(raw)
        is_line_buffered = number == 2 or terminal.isatty()
        writer = io.BufferedWriter(terminal)
        setattr(sys, name, io.TextIOWrapper(writer, encoding, "backslashreplace", line_buffering=is_line_buffered))
        if hasattr(os, "register_at_fork"):
            os.register_at_fork(after_in_child=terminal.backlog.clear)


def _open_null_stream(number: int) -> None:
    try:
        os.fstat(number)
    except OSError:
        opened = os.open(os.devnull, os.O_RDWR)
        if opened == number:
            os.set_inheritable(number, True)
        else:
            os.dup2(opened, number)
            os.close(opened)


def close_streams() -> OSError | None:
    """Flush buffered output and wait for readers. Return the error by which a part of the result on standard output was lost, or
    None."""
    for stream in (sys.stdout, sys.stderr):
        stream.flush()
        terminal = _find_terminal_writer(stream)
        if terminal is not None:
            terminal.flush_backlog()
    terminal = _find_terminal_writer(sys.stdout)
    return None if terminal is None else terminal.loss_reason


def _find_terminal_writer(stream: TextIO) -> TerminalWriter | None:
    raw = getattr(getattr(stream, "buffer", None), "raw", None)
    return raw if isinstance(raw, TerminalWriter) else None


@contextmanager
def treat_output_as_notes(stream: TextIO | None = None) -> Iterator[None]:
    """While the context is active, treat everything that is printed to `stream` (by default standard output) as notes. Notes do
    not delay the work, and a lost note does not change the exit code."""
    stream = sys.stdout if stream is None else stream
    terminal = _find_terminal_writer(stream)
    if terminal is None or terminal.is_note:
        yield
        return
    stream.flush()
    terminal.is_note = True
    try:
        yield
        stream.flush()
    finally:
        terminal.is_note = False


def print_note(words: str = "", *, to_stderr: bool = False, newline: bool = True) -> None:
    """Print a note: a text that is not part of the command's result."""
    stream = sys.stderr if to_stderr else sys.stdout
    with treat_output_as_notes(stream):
        stream.write(words + "\n" if newline else words)
        stream.flush()


def print_result(text: str, *, newline: bool = True) -> None:
    """Print a part of the command's result to standard output. If the text cannot be written, for example on a full disk, the
    command ends with exit code 3."""
    sys.stdout.write(text + "\n" if newline else text)
    sys.stdout.flush()
