"""The choice of where a command's tasks run: in processes on this machine, or on a new or existing Dask cluster.

This module also handles Ctrl-C and SIGTERM. Workers of a cluster read a cache from a shared folder, or receive its files.
"""

from __future__ import annotations

import ipaddress
import re
import signal
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack, contextmanager
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from antdsl.cli.exits import CommandError, ExitCode
from antdsl.cli.printing.messages import print_note
from antdsl.numerics.processor.host import count_available_cores

if TYPE_CHECKING:
    from antdsl.executors import Engine, Task, TaskOutcome
    from antdsl.executors.input_bundle import VisibleFile
    from antdsl.shots.task_destination import Destination

SchedulerAddress = tuple[
    str | None, Path | None, bool
]  # address of a scheduler, certificates, and whether it may run without them
SCHEDULER_OPTION: Any = typer.Option(
    None,
    "--scheduler",
    metavar="ADDRESS",
    help="Run on a Dask cluster: `local` starts one here, tls://HOST:8786 uses a running one; needs the extra [cluster].",
)
TLS_OPTION: Any = typer.Option(
    None, "--tls", metavar="DIR", help="For a running scheduler: the folder with ca.pem, cert.pem and key.pem."
)
NO_TLS_OPTION: Any = typer.Option(
    False,
    "--no-tls",
    help="Use a scheduler on another machine without encryption: anyone who can reach it can run any code on it.",
)
_INSTALL_HINT = "pip install 'antdsl[cluster]'"


def require_scheduler(address: str | None, tls: Path | None, no_tls: bool) -> None:
    """Raise BadParameter if the scheduler options contradict each other. Call this before anything is created."""
    if address is not None:
        _find_certificate_folder(address, tls, no_tls)
    elif tls is not None or no_tls:
        flag = "--tls" if tls is not None else "--no-tls"
        raise typer.BadParameter(
            "this option needs a scheduler: add `--scheduler tls://HOST:8786`, or omit the option", param_hint=flag
        )


@contextmanager
def open_engine(
    scheduler: SchedulerAddress, workers: int, threads: int, files: Iterable[Path], visible_file: VisibleFile | None = None
) -> Iterator[Engine]:
    """Yield the engine that runs the tasks of a command. Problems end the command.

    Without an address in `scheduler`, the engine has `workers` processes with `threads` threads each. Otherwise it is the
    cluster at that address. Its workers receive `files`, or can read `visible_file` at its path. Raises WorkersLostError if no
    scheduler answers."""
    address, tls, no_tls = scheduler
    if not address:
        from antdsl.executors import ProcessEngine

        yield ProcessEngine(workers, threads)
        return
    folder = _find_certificate_folder(address, tls, no_tls)
    from importlib.util import find_spec

    if find_spec("distributed") is None or find_spec("cryptography") is None:
        words = "error: `--scheduler` needs Dask"
        raise CommandError(
            ExitCode.INPUT_OUTPUT, words, f"install it: {_INSTALL_HINT}; without `--scheduler`, everything runs on this machine"
        )
    from antdsl.executors import TaskRejectedError
    from antdsl.executors.cluster import connect_cluster, load_security, start_local_cluster

    try:
        with ExitStack() as stack:
            security = None if folder is None else load_security(folder)
            if address == "local":
                address, security = stack.enter_context(start_local_cluster(workers, threads))
            yield stack.enter_context(connect_cluster(address, security, files, visible_file))
    except TaskRejectedError as error:
        raise CommandError(ExitCode.INPUT_OUTPUT, f"error: {error}") from None


def _find_certificate_folder(address: str, tls: Path | None, no_tls: bool) -> Path | None:
    """Return the folder with the certificates for an address, or None if none are needed."""
    from antdsl.executors.tasks import TLS_FILE_NAMES

    match = re.fullmatch(r"(tls|tcp)://(\[[0-9A-Fa-f:.]{2,45}\]|[A-Za-z0-9_.-]{1,253}):([0-9]{1,5})", address)
    if address == "local":
        if tls is not None or no_tls:
            raise typer.BadParameter("a local cluster creates its own certificates", param_hint="--tls")
        return None
    if match is None or not 0 < int(match[3]) < 1 << 16:
        raise typer.BadParameter(
            f"`{address}` is not a scheduler: write `local`, or an address such as tls://render1:8786", param_hint="--scheduler"
        )
    if match[1] == "tls":
        if tls is None:
            raise typer.BadParameter(
                f"`{address}` needs certificates: name their folder with `--tls DIR`", param_hint="--scheduler"
            )
        missing = [name for name in TLS_FILE_NAMES if not (tls / name).is_file()]
        if missing:
            raise typer.BadParameter(f"`{tls}` has no `{missing[0]}`", param_hint="--tls")
        _require_certificates(tls)
        return tls
    if tls is not None:
        raise typer.BadParameter(f"`{address}` is not encrypted; write tls://{match[2]}:{match[3]}", param_hint="--scheduler")
    if not no_tls and not _is_loopback_address(match[2].strip("[]")):
        raise typer.BadParameter(
            f"`{address}` is not encrypted, so everyone who can reach it can run code on it; write tls:// and `--tls DIR`, or, "
            "on a network that is trusted, add `--no-tls`",
            param_hint="--scheduler",
        )
    return None


def _require_certificates(folder: Path) -> None:
    """Raise BadParameter unless the files in a folder are certificates, and `key.pem` is the key of `cert.pem`. Without this
    check, Dask would only report that no scheduler answers."""
    import ssl

    from antdsl.executors.tasks import TLS_FILE_NAMES

    authority, certificate, key = (folder / name for name in TLS_FILE_NAMES)
    for certificate_file, words in (
        (authority, "is no certificate"),
        (certificate, "and `key.pem` are not a certificate with its key"),
    ):
        context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
        try:
            if certificate_file == authority:
                context.load_verify_locations(authority)
            else:
                context.load_cert_chain(certificate, key, password="")  # without a password, OpenSSL would prompt for one
        except (OSError, ValueError):  # an SSLError is an OSError
            message = f"`{certificate_file}` {words}; the page on clusters of the documentation has the commands that make them"
            raise typer.BadParameter(message, param_hint="--tls") from None


def _is_loopback_address(host: str) -> bool:
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"


class TerminationSignal(KeyboardInterrupt):
    """The exception that SIGTERM raises. It is handled like Ctrl-C, but leads to a different exit code."""


def choose_stop_exit_code(exception: BaseException) -> ExitCode:
    """Return the exit code of a command that was stopped by Ctrl-C or by SIGTERM."""
    return ExitCode.TERMINATED if isinstance(exception, TerminationSignal) else ExitCode.INTERRUPTED


@contextmanager
def raise_on_sigterm() -> Iterator[None]:
    """While the context is active, SIGTERM raises TerminationSignal, just as Ctrl-C raises KeyboardInterrupt."""

    def raise_signal(number: int, frame: object) -> None:
        raise TerminationSignal if number == signal.SIGTERM else KeyboardInterrupt

    previous_handlers = {number: signal.signal(number, raise_signal) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield
    finally:
        for number, handler in previous_handlers.items():
            signal.signal(number, handler)


def run_cache_tasks(
    scheduler: SchedulerAddress, cache: Path, folder: Path, make_tasks: Callable[[Path, Destination], Iterable[Task]]
) -> Iterator[TaskOutcome]:
    """Run tasks on a cluster, and yield the outcome of each task as soon as its files are in `folder`. If a task fails, the
    command ends after all tasks have run. It also ends if the connection to the scheduler is lost.

    `scheduler`: address, certificates, and whether the scheduler may run without certificates.
    `make_tasks`: called with the path of the cache (links resolved) and the destination of files; returns the tasks.
    """
    from antdsl.executors import WorkersLostError, run_tasks
    from antdsl.executors.input_bundle import VisibleFile
    from antdsl.outputs.cache.cache_reader import STATIC_FILE_NAME, make_frame_path, open_cache
    from antdsl.outputs.cache.hashes import HASHES_FILE_NAME
    from antdsl.outputs.cache.manifest import MANIFEST_FILE_NAME
    from antdsl.safe_read import resolve_path
    from antdsl.shots.task_destination import mark_folder

    cache = resolve_path(cache)
    edits = open_cache(cache).manifest.edits
    if edits is not None and edits.caches:
        message = "error: the cache has edits that merge other caches, which a cluster does not read"
        raise CommandError(ExitCode.FINDINGS, message, f"write them into a cache first: `antdsl edit {cache} --to DIR`")
    files = [
        *(cache / name for name in (MANIFEST_FILE_NAME, STATIC_FILE_NAME, HASHES_FILE_NAME)),
        *((cache / edits.arrays,) if edits is not None and edits.arrays is not None else ()),
        *(make_frame_path(cache, f) for f in open_cache(cache).frames()),
    ]
    failure_count = 0
    print_warning = partial(print_note, to_stderr=True)
    try:
        with (
            open_engine(scheduler, count_available_cores(), 1, files, VisibleFile.from_path(cache / HASHES_FILE_NAME)) as engine,
            mark_folder(folder) as place,
        ):
            for answered in run_tasks(
                make_tasks(cache, place), engine, report_note=print_warning, choose_folder=lambda task: folder
            ):
                if answered.answer is None:
                    failure_count += 1
                    first, last = (answered.task.document["frames"][number] for number in (0, -1))
                    print_warning(f"failed: frames {first}..{last}: {answered.problem}")
                else:
                    yield answered
    except WorkersLostError as error:
        raise CommandError(ExitCode.INPUT_OUTPUT, f"error: {error}", "the same command computes all frames again") from None
    if failure_count:
        raise CommandError(ExitCode.FINDINGS, "error: the failed frames are missing")
