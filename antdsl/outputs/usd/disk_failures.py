"""What USD says of a disk that fails, as an OSError."""

from __future__ import annotations

import errno
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from antdsl.scene.geometry.usd import pxr

_OF_DISKS = (
    errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO, errno.EROFS, errno.EACCES, errno.EPERM, errno.EMFILE, errno.ENOENT,
    errno.ESTALE, errno.EINTR,
)  # fmt: skip


@contextmanager
def disk_failures(path: Path) -> Iterator[None]:
    """Raise an OSError that names `path` where a disk fails while USD writes. USD has the system's words in its own errors only;
    any other error of it passes."""
    try:
        yield
    except pxr("Tf").ErrorException as problem:
        said = str(problem)
        number = next((each for each in _OF_DISKS if os.strerror(each) in said), None)
        if number is None:
            raise
        raise OSError(number, os.strerror(number), str(path)) from None
