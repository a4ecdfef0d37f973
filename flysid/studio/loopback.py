"""A port on loopback, and who may ask there: what every server of pages holds to."""

from __future__ import annotations

import contextlib
import hmac
import secrets
import socket
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from http.cookies import CookieError, SimpleCookie

from flysid.errors import UsageError

UNKNOWN = "open the address that 'flysid studio' has printed: it carries the token\n"
HOST = "127.0.0.1"
HEAD_S = 5.0
"""For a request's first lines to arrive in full: a browser on this machine takes a thousandth of it."""
POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self'; connect-src 'self'; "
    "frame-src 'self'; frame-ancestors 'none'; base-uri 'none'; form-action 'none'"
)
HEADERS = {
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cache-Control": "no-store",
}


@dataclass(frozen=True)
class Key:
    """What a browser must know, and where it must have come from."""

    port: int
    token: str = field(default_factory=lambda: secrets.token_urlsafe(24))

    @property
    def cookie(self) -> str:
        """Named by the port: two studios do not log each other out."""
        return f"flysid-{self.port}"

    @property
    def hosts(self) -> tuple[str, ...]:
        return tuple(f"{name}:{self.port}" for name in (HOST, "localhost", "[::1]"))

    @property
    def address(self) -> str:
        return f"http://{HOST}:{self.port}/?token={self.token}"

    def fits(self, offered: str) -> bool:
        return hmac.compare_digest(offered.encode(), self.token.encode())

    def is_known(self, cookies: str) -> bool:
        """Whether a request's cookies hold the token."""
        try:
            found = SimpleCookie(cookies).get(self.cookie)
        except CookieError:
            return False
        return found is not None and self.fits(found.value)


def refusal(key: Key, headers: Mapping[str, str]) -> tuple[int, str] | None:
    """Status and words for a request that was meant for another host or comes from another site's page."""
    if headers.get("host", "") not in key.hosts:
        return 421, "this server answers on 127.0.0.1 and localhost only\n"
    origin = headers.get("origin")
    is_foreign = origin is not None and origin.removeprefix("http://") not in key.hosts
    if is_foreign or headers.get("sec-fetch-site", "none") not in ("same-origin", "none"):
        return 403, "requests of other sites are refused\n"
    return None


@contextlib.contextmanager
def bound(port: int) -> Iterator[socket.socket]:
    """A socket on loopback; `port` 0 takes any that is free.

    Raises UsageError: the port is in use, or not ours to take.
    """
    with socket.socket(socket.AF_INET, socket.SOCK_STREAM) as listening:
        listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            listening.bind((HOST, port))
        except (OSError, OverflowError) as error:
            raise UsageError(
                f"port {port} cannot be used: {error}", hint="leave out --port: a free one is taken"
            ) from error
        listening.listen(128)
        yield listening
