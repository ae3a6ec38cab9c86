"""The page's own files, held in memory: no path of a request ever reaches the disk."""

import hashlib
from importlib.resources import files
from importlib.resources.abc import Traversable

from starlette.requests import Request
from starlette.responses import PlainTextResponse, Response

MEDIA_TYPES = {".html": "text/html", ".css": "text/css", ".js": "text/javascript", ".svg": "image/svg+xml"}


class StaticFiles:
    """Answers requests for the page's files."""

    def __init__(self) -> None:
        self._content = _read(files(__package__).joinpath("static"), "")

    async def answer(self, request: Request) -> Response:
        """The file of this path; the page itself for the empty one."""
        path = request.path_params.get("path") or "page.html"
        content = self._content.get(path)
        if content is None:
            return PlainTextResponse("no such file\n", 404)
        # The browser asks each time, so that it never mixes the files of two versions; it loads only what has changed.
        tag = f'"{hashlib.sha256(content).hexdigest()[:32]}"'
        headers = {"cache-control": "no-cache", "etag": tag}
        if request.headers.get("if-none-match") == tag:
            return Response(status_code=304, headers=headers)
        return Response(content, media_type=MEDIA_TYPES[path[path.rindex(".") :]], headers=headers)


def _read(folder: Traversable, above: str) -> dict[str, bytes]:
    content: dict[str, bytes] = {}
    for entry in folder.iterdir():
        if entry.is_dir():
            content |= _read(entry, f"{above}{entry.name}/")
        elif entry.name.endswith(tuple(MEDIA_TYPES)):
            content[f"{above}{entry.name}"] = entry.read_bytes()
    return content
