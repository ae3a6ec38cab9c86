"""What keeps others from a page that other machines can reach."""

import secrets

from ..address import is_loopback

TOKEN_BYTES = 16


def new_token(host: str) -> str | None:
    """For a page at this host; none where only this machine can reach it."""
    return None if is_loopback(host) else secrets.token_urlsafe(TOKEN_BYTES)
