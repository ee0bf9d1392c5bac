"""Who may speak to the page's servers: token, Host and Origin; and how guessing is slowed.

The token never stands in an address that is sent: the link that is printed has it behind ``#``, which browsers keep
to themselves; the page sends it once, in a body, and gets a cookie that scripts cannot read.
"""

from __future__ import annotations

import hashlib
import hmac
import re
import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from http.cookies import CookieError, SimpleCookie
from typing import NamedTuple

BODY_LIMIT_BYTES = 4096
"""Orders and tokens are short; nothing is uploaded."""
_LOOPBACK = ("127.0.0.1", "localhost", "[::1]")


class RateLimit:
    """Counts failures by address over a time that slides.

    Parameters
    ----------
    most
        Failures of one address that are borne.
    most_in_all
        Of all addresses together.
    window_s
        How long a failure counts.
    clock
        Seconds.

    Examples
    --------
    >>> limit = RateLimit(most=2, clock=lambda: 0.0)
    >>> for _ in range(2):
    ...     limit.fail("10.0.0.9")
    >>> limit.wait_s("10.0.0.9"), limit.wait_s("10.0.0.8")
    (60.0, 0.0)
    """

    def __init__(
        self, most: int = 10, most_in_all: int = 100, window_s: float = 60.0,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:  # fmt: skip
        self._most, self._most_in_all, self._window_s, self._clock = most, most_in_all, window_s, clock
        self._failures: deque[tuple[float, str]] = deque()

    def fail(self, address: str) -> None:
        """Count a failure."""
        self._failures.append((self._clock(), address))
        while len(self._failures) > self._most_in_all:
            self._failures.popleft()

    def wait_s(self, address: str) -> float:
        """Return how long an address must wait; 0 where it need not."""
        now = self._clock()
        while self._failures and self._failures[0][0] <= now - self._window_s:
            self._failures.popleft()
        own = [when for when, of in self._failures if of == address]
        counted = own if len(own) >= self._most else [when for when, _ in self._failures]
        is_over = len(own) >= self._most or len(self._failures) >= self._most_in_all
        return counted[0] + self._window_s - now if is_over else 0.0


class Refusal(Exception):  # noqa: N818 - it is an answer, not a fault of ours
    """A request that is not let in."""

    def __init__(self, status: int, why: str, wait_s: float = 0.0) -> None:
        super().__init__(why)
        self.status, self.why, self.wait_s = status, why, wait_s


class Asked(NamedTuple):
    """A request, as far as it decides about being let in."""

    method: str
    headers: Mapping[str, Sequence[str]]
    """Name, in small letters, to its values."""
    client: str
    """Address that it comes from."""
    own_address: str | None
    """Address that it came to."""
    is_socket: bool = False

    def header(self, name: str, default: str = "") -> str:
        """Return the first value of a header."""
        return next(iter(self.headers.get(name, ())), default)


@dataclass
class Access:
    """What is let in.

    Parameters
    ----------
    token
        The secret.
    port
        Where the page is served.
    names
        Host names, besides those of this machine's loopback, under which the page may be asked for.
    stop_port
        Where Stop has its own listener; None where it has none.
    limit
        On wrong tokens.
    """

    token: str
    port: int
    names: tuple[str, ...] = ()
    stop_port: int | None = None
    limit: RateLimit = field(default_factory=RateLimit)

    @property
    def cookie_name(self) -> str:
        """Cookies do not tell ports apart; their names do."""
        return f"vialight-{self.port}"

    @property
    def cookie_value(self) -> str:
        """Proves that the token was known, also to the server that comes after a restart."""
        return hmac.new(self.token.encode(), b"vialight page", hashlib.sha256).hexdigest()

    def is_host(self, host: str, own_address: str | None, port: int | None = None) -> bool:
        """Tell whether a Host header names this server, by default the page's.

        A page of another site whose name was bound to our address (DNS rebinding) comes with that site's name.  The
        very address that the connection came to is always ours.
        """
        port = self.port if port is None else port
        known = [*_LOOPBACK, *self.names]
        if own_address:
            known.append(f"[{own_address}]" if ":" in own_address else own_address)
        allowed = {f"{name.lower()}:{port}" for name in known}
        if port == 80:
            allowed |= {name.lower() for name in known}
        return host.lower() in allowed

    def is_token(self, given: str) -> bool:
        """Compare in constant time."""
        return hmac.compare_digest(_bytes(given), _bytes(self.token))

    def is_cookie(self, given: str) -> bool:
        """Compare in constant time."""
        return hmac.compare_digest(_bytes(given), _bytes(self.cookie_value))

    def check_names(self, asked: Asked, port: int | None = None) -> None:
        """Refuse what was not meant for this server, or comes from a page that is not ours.

        Parameters
        ----------
        asked
            The request.
        port
            Where it came to, where that is Stop's own listener: a browser calls our page there one of the same site
            and of another origin.

        Raises
        ------
        Refusal
            It is not for us.
        """
        hosts = asked.headers.get("host", ())
        if len(hosts) != 1 or not self.is_host(hosts[0], asked.own_address, port):
            raise Refusal(421, "this name is not one of this server's; use the address that vialight printed")
        ours = self.origins(hosts[0])
        if any(origin.lower() not in ours for origin in asked.headers.get("origin", ())):
            raise Refusal(403, "asked for by a page of another origin")
        sites = ("none", "same-origin") if port is None else ("none", "same-origin", "same-site")
        is_visit = asked.method == "GET" and asked.header("sec-fetch-mode") == "navigate" and not asked.is_socket
        if asked.header("sec-fetch-site", "none") not in sites and not is_visit:
            raise Refusal(403, "asked for by a page of another site")

    def origins(self, host: str) -> set[str]:
        """Return how browsers may call the page's origin when it was reached under a name.

        Examples
        --------
        >>> Access("secret", 8765).origins("localhost:8766")
        {'http://localhost:8765'}
        """
        name = name_of(host)
        return {f"http://{name}:{self.port}"} | ({f"http://{name}"} if self.port == 80 else set())

    def check_secret(self, asked: Asked) -> None:
        """Take the cookie from our own page, or the token from a program.

        A browser says where an order or a socket comes from; without that a cookie proves nothing.

        Raises
        ------
        Refusal
            There is neither.
        """
        is_own = "origin" in asked.headers or (asked.method == "GET" and not asked.is_socket)
        if is_own and self.has_cookie(asked):
            return  # also while others at this address guess: who may stop the print must not be locked out
        bearer = asked.header("authorization")
        is_bearer = bearer.lower().startswith("bearer ")
        if is_bearer and self.is_token(bearer[7:].strip()):
            return  # as little: 256 bits are not guessed, however often it is tried
        wait_s = self.limit.wait_s(asked.client)
        if wait_s > 0:
            raise Refusal(429, f"too many wrong tokens; wait {wait_s:.0f} s", wait_s)
        if is_bearer:
            self.limit.fail(asked.client)
            raise Refusal(401, "wrong token")
        if is_own and _cookie(asked, self.cookie_name) is not None:
            self.limit.fail(asked.client)
            raise Refusal(401, "the token has changed; open the link that vialight printed")
        raise Refusal(401, "needs the token; open the link that vialight printed")

    def has_cookie(self, asked: Asked) -> bool:
        """Tell whether a request brings the page's cookie."""
        cookie = _cookie(asked, self.cookie_name)
        return cookie is not None and self.is_cookie(cookie)


def name_of(host: str) -> str:
    """Return a Host header's name, without the port.

    Examples
    --------
    >>> name_of("Printer.lab:8765"), name_of("[::1]:80"), name_of("[::1]")
    ('printer.lab', '[::1]', '[::1]')
    """
    return re.sub(r":\d*$", "", host.lower()) if not host.endswith("]") else host.lower()


def _bytes(text: str) -> bytes:
    return text.encode("utf-8", "surrogatepass")  # what JSON may hold, and UTF-8 not


def _cookie(asked: Asked, name: str) -> str | None:
    try:
        found = SimpleCookie(asked.header("cookie")).get(name)
    except CookieError:
        return None
    return found.value if found else None
