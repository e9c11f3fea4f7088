"""`antdsl preview SCENE`: displays a scene in a browser, and updates it while its files are edited."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import typer

from antdsl.cli.exits import CommandError, ExitCode
from antdsl.cli.printing.messages import print_note

if TYPE_CHECKING:
    from antdsl.pipeline import RunChoices
    from antdsl.preview.live import LiveSimulation
    from antdsl.preview.serving.addresses import ListeningSockets


def run_preview_command(
    scene: Path = typer.Argument(..., help="A scene.yaml."),
    port: int = typer.Option(
        None, "--port", min=0, max=65535, help="Port to listen on; 0: any free port. [default: 8765, or the next free port]"
    ),
    no_open: bool = typer.Option(False, "--no-open", help="Print the address without opening a browser."),
    seed: int = typer.Option(None, "--seed", min=0, max=2**64 - 1, help="Seed; overrides the scene."),
    set_: list[str] = typer.Option([], "--set", metavar="NAME=VALUE", help="Value of a param, such as forager.smell=50mm"),
    root: list[str] = typer.Option([], "--root", metavar="NAME=DIR", help="Grant the scene a folder of assets outside its own."),
    threads: int = typer.Option(
        0,
        "--threads",
        min=0,
        max=256,
        help="Threads for rays, kernels and NumPy's chunks; 0: all available cores. Does not change results.",
    ),
    host: str = typer.Option(
        None, "--host", metavar="HOST", help="Listen at this address instead of this machine's own; needs --let-others-in."
    ),
    let_others_in: bool = typer.Option(
        False, "--let-others-in", help="With --host: anyone with the address may watch and steer."
    ),
) -> None:
    """Watch a scene while you write it: a page in the browser that reloads, rewinds and explains. Needs the extra [preview]."""
    from antdsl.cli.printing.reports import exit_on_errors
    from antdsl.packages import check_extra

    exit_on_errors(check_extra("the preview", "preview", "websockets"))
    from antdsl.cli.arguments import parse_grants, parse_pairs, require_scene

    require_scene(scene)
    from antdsl.pipeline import RunChoices

    choices = RunChoices(parse_grants(root), None, seed, parse_pairs(set_, "--set"))
    listening = _open_sockets(host, port, let_others_in)
    try:
        live = _create_live(scene, choices, threads)
        _serve_preview(
            live,
            scene,
            listening,
            opens_browser=not no_open,
            allows_others=host is not None and let_others_in,
            allows_reconnect=port != 0,
        )
    finally:
        listening.close()


def _open_sockets(host: str | None, port: int | None, let_others_in: bool) -> ListeningSockets:
    from antdsl.preview.serving.addresses import ListenError, is_loopback, open_listening_sockets

    try:
        if not is_loopback(host) and not let_others_in:
            raise CommandError(
                ExitCode.USAGE,
                f"error: `--host {host}` gives other machines access",
                "anyone with the address and its token could watch this scene, read its programs and steer the run; anyone who\n"
                "can read the network traffic could read the token. Confirm with `--let-others-in`, or omit `--host`\n"
                "and connect through `ssh -L 8765:127.0.0.1:8765`",
            )
        return open_listening_sockets(host, port)
    except ListenError as error:
        raise CommandError(
            ExitCode.INPUT_OUTPUT, f"error: {error}", "choose another with `--port` or `--host`, or omit them"
        ) from None


def _create_live(scene: Path, choices: RunChoices, threads: int) -> LiveSimulation:
    """Return the live simulation of a scene. If its files have errors, these are reported, and the simulation starts once they
    are corrected."""
    from antdsl.cli.commands.run import choose_threads
    from antdsl.cli.printing.reports import choose_exit_code, print_report
    from antdsl.preview.live import LiveSimulation
    from antdsl.runtime import Options

    live = LiveSimulation.open_scene(scene, choices, Options(threads=choose_threads(threads), feet=True))
    print_report(live.report, to_stderr=True)
    if choose_exit_code(live.report) is ExitCode.INPUT_OUTPUT:
        raise CommandError(ExitCode.INPUT_OUTPUT)
    if not live.report.ok and _depends_on_params(choices, live):
        raise CommandError(ExitCode.FINDINGS)
    return live


def _depends_on_params(choices: RunChoices, live: LiveSimulation) -> bool:
    """Return whether the values given on the command line are the cause of the errors: without these values, the files have no
    errors."""
    from dataclasses import replace

    if not choices.params:
        return False
    shot, report = live.compiler.open(replace(choices, params={}))
    return shot is not None and report.ok


def _serve_preview(
    live: LiveSimulation,
    scene: Path,
    listening: ListeningSockets,
    *,
    opens_browser: bool,
    allows_others: bool,
    allows_reconnect: bool,
) -> None:
    """Serve the preview until the user stops it.

    `allows_others`: whether anyone with the address may use it. `allows_reconnect`: whether open pages reconnect if the server
    is restarted on this port."""
    from antdsl.preview.serving.guard import RequestGuard, ReturningPages
    from antdsl.preview.serving.page_files import load_pages
    from antdsl.preview.serving.server import PreviewServer, run_server

    # traffic on a network is not encrypted: a reader of a key could use it to return
    returning = ReturningPages.open_for_server(scene, listening.port) if allows_reconnect and not allows_others else None
    guard = RequestGuard(listening.host_names, returning_pages=returning)
    server = PreviewServer(live, guard, load_pages(), listening)

    def print_addresses() -> None:
        for address in listening.addresses:
            print_note(f"{address}#{guard.token}")
        if allows_others:
            print_note(
                "Other machines can reach this preview. Anyone with the address and its token can watch the scene, read its\n"
                "programs and steer the run, but cannot read or write other files. Network traffic is not encrypted."
            )
        waiting = "" if live.report.ok else f" {scene} has errors. The page shows them; the agents appear once you correct them."
        print_note(f"Press Ctrl-C to end it.{waiting}")
        if opens_browser:
            _open_browser(f"{listening.addresses[0]}#{guard.make_invitation_code()}")

    live.start()
    try:
        run_server(server, print_addresses)
    except KeyboardInterrupt:
        pass  # the normal end of a preview
    finally:
        live.stop()


def _open_browser(address: str) -> None:
    """Open a browser, unless there is no graphical display: a text browser would then block this terminal."""
    import os
    import sys
    import webbrowser
    from threading import Thread

    if sys.platform.startswith("linux") and not any(os.environ.get(name) for name in ("DISPLAY", "WAYLAND_DISPLAY", "BROWSER")):
        return
    Thread(target=webbrowser.open, args=(address,), daemon=True).start()
