"""The program that the reader process runs. It is started by its path: `python -P -S child.py CONFIGURATION`.

The configuration is a JSON object: `paths` for `sys.path`, `readable` folders, and `modules` to import. The process confines
itself and reports the active layers of confinement. It then answers requests from its standard input until that is closed. After
a request that ran out of memory, it ends."""

from __future__ import annotations

import json
import os
import sys
import time
from contextlib import suppress
from importlib import import_module
from typing import Any


def main() -> None:
    """Answer requests until the pipe is closed."""
    configuration = json.loads(sys.argv[1])
    sys.path[:] = configuration["paths"]
    requests, answers = os.fdopen(os.dup(0), "rb", buffering=1 << 16), os.fdopen(os.dup(1), "wb", buffering=1 << 16)
    null_device = os.open(os.devnull, os.O_RDWR)
    for stream in (0, 1, 2):  # libraries write their own warnings
        os.dup2(null_device, stream)
    os.close(null_device)
    from antdsl.reader import sandbox

    active = sandbox.confine_process(configuration["readable"])
    from antdsl import limits
    from antdsl.reader import protocol

    protocol.write_message(answers, {"active": active}, {})
    with suppress(ImportError):  # the request then reports the missing package
        for module in configuration["modules"]:
            import_module(module)
    while True:
        try:
            request = protocol.read_message(requests, limits.MAX_READER_ARRAY_BYTES)
        except protocol.ProtocolError:
            return
        sandbox.limit_request(int(request.document["seconds"]), int(request.document["memory"]))
        document, arrays, is_last = _answer_request(request)
        protocol.write_message(answers, document | {"cpu": time.process_time()}, arrays)
        if is_last:
            return


def _answer_request(request: Any) -> tuple[dict[str, Any], dict[str, Any], bool]:
    """Return the answer to a request, its arrays, and whether it is the last answer of the process."""
    from antdsl.packages import INSTALL_ADVICE, find_missing_distribution
    from antdsl.reader import READER_FUNCTIONS
    from antdsl.reader.protocol import RefusalError

    try:
        module, function = READER_FUNCTIONS[request.document["kind"]]
        document, arrays = getattr(import_module(module), function)(request)
    except RefusalError as error:
        return {"refusal": error.make_document()}, {}, False
    except MemoryError:
        return {"failure": "memory"}, {}, True
    except ModuleNotFoundError as problem:
        distribution = find_missing_distribution(problem) or problem.name
        refusal = RefusalError("missing-extra", f"needs the package {distribution}, which is not installed", INSTALL_ADVICE)
        return {"refusal": refusal.make_document()}, {}, False
    except Exception as problem:  # an exception of a library, with arbitrary text
        return {"failure": "exception", "name": type(problem).__name__[:80]}, {}, False
    return {"answer": document}, arrays, False


if __name__ == "__main__":
    main()
