"""Who may talk to the studio: whoever has opened the URL with its token, from the studio's own page.

The token is in the URL that is printed. It is exchanged for a cookie at once, so that it neither stays in the address
bar nor goes to other servers. Browsers send the cookie with what pages of this host ask for, and where a link leads to
the page (SameSite=Lax: a stricter one would be missing where the URL is clicked in a terminal that is a page itself);
its name has random letters, since they share cookies between all ports of a host: studios of several machines may have
one port there, and tunnels lead to them from others.
"""

from __future__ import annotations

import hmac
import secrets
from http.cookies import CookieError, SimpleCookie


class Access:
    """The token of a studio and the rules that follow from it.

    Attributes:
        token: 256 random bits as text for a URL.
    """

    def __init__(self) -> None:
        self.token = secrets.token_urlsafe(32)
        self._cookie = f"tnst_mi_studio_{secrets.token_hex(4)}"

    def opened_by(self, token: str) -> bool:
        """Whether a token is the right one; the time this takes tells nothing about it."""
        return hmac.compare_digest(token.encode("utf-8"), self.token.encode("ascii"))

    def admits(self, cookies: str | None) -> bool:
        """Whether the cookies of a request have the right token."""
        try:
            morsel = SimpleCookie(cookies or "").get(self._cookie)
        except CookieError:
            return False
        return morsel is not None and self.opened_by(morsel.value)

    @property
    def set_cookie(self) -> str:
        """The value of the header Set-Cookie that lets a browser in."""
        return f"{self._cookie}={self.token}; Path=/; HttpOnly; SameSite=Lax"


def from_own_page(origin: str | None, host: str | None) -> bool:
    """Whether what changes something comes from the studio's own page.

    A page of another port of this machine has the cookie too, since it is of the same site; browsers say where such
    requests come from.

    Args:
        origin: the header Origin; programs that are no browsers send none.
        host: the header Host, which a tunnel may have changed for both.
    """
    return origin is None or (host is not None and origin in (f"http://{host}", f"https://{host}"))
