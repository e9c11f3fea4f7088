"""The addresses at which the server listens, the host names that it accepts, and the addresses to open in a browser."""

from __future__ import annotations

import errno
import socket
import sys
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import dataclass
from ipaddress import ip_address

DEFAULT_PORT = 8765
_MAX_PORT_ATTEMPTS = 64  # ports tried in order if none was requested
_LOOPBACK_ADDRESSES = ("127.0.0.1", "::1")
_MISSING_ADDRESS_ERRORS = (errno.EADDRNOTAVAIL, errno.EAFNOSUPPORT)  # for example `::1` on a machine without IPv6


class ListenError(Exception):
    """Error if no socket can be opened at an address. The message is written for the user."""


@dataclass(frozen=True, slots=True)
class ListeningSockets:
    """Bound sockets. `host_names`: the `host:port` texts that requests may name. `addresses`: addresses to open in a browser,
    the best first."""

    sockets: tuple[socket.socket, ...]
    host_names: frozenset[str]
    addresses: tuple[str, ...]

    @property
    def port(self) -> int:
        """Return the port, which all sockets share."""
        return int(self.sockets[0].getsockname()[1])

    def close(self) -> None:
        """Close all sockets."""
        for each in self.sockets:
            each.close()


def is_loopback(host: str | None) -> bool:
    """Return whether a host can be reached only from this machine. Raises ListenError if the host is unknown."""
    return host is None or all(ip_address(each).is_loopback for each in _resolve_host(host))


def open_listening_sockets(host: str | None = None, port: int | None = None) -> ListeningSockets:
    """Return sockets that are bound to the loopback interface, or to `host`. `port`: by default the first free port from 8765
    on; 0 takes any free port. Raises ListenError if the requested port is taken, or if this machine does not have the host."""
    addresses = _LOOPBACK_ADDRESSES if host is None else _resolve_host(host)
    for candidate in (port,) if port is not None else range(DEFAULT_PORT, DEFAULT_PORT + _MAX_PORT_ATTEMPTS):
        try:
            sockets, taken = _bind_sockets(addresses, candidate)
        except OSError as why:
            if why.errno == errno.EADDRINUSE and port is None:
                continue
            raise ListenError(_describe_listen_error(why, host, candidate)) from None
        names = [_format_url_host(name) for name in _list_server_names(host, addresses)]
        display_names = [_format_url_host(name) for name in _list_browser_addresses(host, addresses, sockets)]
        return ListeningSockets(
            sockets, frozenset(f"{name}:{taken}" for name in names), tuple(f"http://{name}:{taken}/" for name in display_names)
        )
    raise ListenError(f"the ports {DEFAULT_PORT} to {DEFAULT_PORT + _MAX_PORT_ATTEMPTS - 1} are all in use")


def _bind_sockets(addresses: Iterable[str], port: int) -> tuple[tuple[socket.socket, ...], int]:
    """Return sockets bound to all addresses on one port, and this port.

    Addresses that this machine lacks are skipped if at least one other remains. Raises OSError if another program uses any of
    the addresses; otherwise `localhost` could lead to that program."""
    sockets: list[socket.socket] = []
    absent: OSError | None = None
    try:
        for place in addresses:
            try:
                sockets.append(_bind_socket(place, port))
            except OSError as why:
                if why.errno not in _MISSING_ADDRESS_ERRORS:
                    raise
                absent = why
            else:
                port = sockets[-1].getsockname()[1]
        if not sockets:
            raise absent or OSError(errno.EADDRNOTAVAIL, "no such address")
    except OSError:
        for each in sockets:
            each.close()
        raise
    return tuple(sockets), port


def _bind_socket(address: str, port: int) -> socket.socket:
    """Return a socket that is bound to one address. Raises OSError if this fails."""
    six = ":" in address
    server_socket = socket.socket(socket.AF_INET6 if six else socket.AF_INET, socket.SOCK_STREAM)
    try:
        if sys.platform == "win32":
            server_socket.setsockopt(socket.SOL_SOCKET, socket.SO_EXCLUSIVEADDRUSE, 1)
        else:
            server_socket.setsockopt(
                socket.SOL_SOCKET, socket.SO_REUSEADDR, 1
            )  # do not wait for connections of an earlier server
        if six:
            server_socket.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_V6ONLY, 1)
        server_socket.bind((address, port))
        server_socket.listen()  # until then, another server may bind the same port
    except OSError:
        server_socket.close()
        raise
    return server_socket


def _resolve_host(host: str) -> tuple[str, ...]:
    """Return the numeric IP addresses of a host."""
    try:
        entries = socket.getaddrinfo(host, None, type=socket.SOCK_STREAM)
    except (OSError, UnicodeError):
        raise ListenError(f"there is no host `{host}`") from None
    return tuple(dict.fromkeys(str(each[4][0]) for each in entries))


def _list_server_names(host: str | None, addresses: Iterable[str]) -> list[str]:
    """Return the names that lead to this server and to no other: the requested host and its addresses.

    A server that listens at every address also has all addresses and names of the machine. Names that an attacker could choose
    are left out."""
    if host is None:
        return ["localhost", *_LOOPBACK_ADDRESSES]
    addresses = list(addresses)
    if any(ip_address(each).is_unspecified for each in addresses):
        return ["localhost", *_LOOPBACK_ADDRESSES, socket.gethostname().lower(), *_find_machine_addresses()]
    return [host.lower(), *addresses]


def _list_browser_addresses(host: str | None, addresses: Iterable[str], sockets: Iterable[socket.socket]) -> list[str]:
    if host is None:
        return [str(each.getsockname()[0]) for each in sockets][:1]
    if any(ip_address(each).is_unspecified for each in addresses):
        return [*_find_machine_addresses(), "127.0.0.1" if "0.0.0.0" in addresses else "::1"]
    return [host.lower()]


def _find_machine_addresses() -> list[str]:
    """Return addresses at which other machines can reach this one. They are the addresses of its host name, and the source
    addresses of its outgoing connections."""
    addresses: list[str] = []
    with suppress(OSError, UnicodeError):
        addresses += [str(each[4][0]) for each in socket.getaddrinfo(socket.gethostname(), None, type=socket.SOCK_STREAM)]
    for family, far in ((socket.AF_INET, "192.0.2.1"), (socket.AF_INET6, "2001:db8::1")):
        # connecting a datagram socket sends nothing; it only selects the route
        with suppress(OSError), socket.socket(family, socket.SOCK_DGRAM) as probe:
            probe.connect((far, 9))
            addresses.append(str(probe.getsockname()[0]))
    return [each for each in dict.fromkeys(addresses) if "%" not in each and not ip_address(each).is_loopback]


def _format_url_host(name: str) -> str:
    return f"[{name}]" if ":" in name else name


def _describe_listen_error(error: OSError, host: str | None, port: int) -> str:
    if error.errno == errno.EADDRINUSE:
        return f"port {port} is in use"
    if error.errno in (errno.EACCES, errno.EPERM):
        return f"you may not listen on port {port}"
    if error.errno in _MISSING_ADDRESS_ERRORS:
        return f"this machine has no address `{host or 'localhost'}`"
    return f"cannot listen on port {port}: {(error.strerror or str(error)).lower()}"
