"""One browser's WebSocket: the newest frame at a bounded pace, the past where it asks for it, the operator's words."""

import asyncio
import json
import math
from typing import Any

from starlette.websockets import WebSocket, WebSocketDisconnect

from .feed import Feed

FRAMES_HZ = 10.0
MESSAGES_HZ = 100.0
"""More than this from a browser waits in the network: reading it must not take the time that the chase needs."""


class Browser:
    """Serves one browser until it leaves.

    Nothing is queued for it: one task sends, waits until the network has taken it, and then looks for what is newest.
    A browser that is slow, or does not read at all, gets fewer frames.
    """

    def __init__(self, feed: Feed, socket: WebSocket) -> None:
        self._feed, self._socket = feed, socket
        self._wanted_s: float | None = None
        """The time of the past frame that it has asked for last."""
        self._wants = asyncio.Event()

    async def serve(self) -> None:
        """Until it leaves."""
        await self._socket.accept()
        try:
            async with asyncio.TaskGroup() as tasks:
                tasks.create_task(self._send())
                tasks.create_task(self._receive())
        except* WebSocketDisconnect:
            pass

    async def _send(self) -> None:
        info = {"kind": "info", **self._feed.info, "is_live": self._feed.is_live}
        await self._socket.send_text(json.dumps(info))
        sent_number, next_frame_s = 0, 0.0
        clock = asyncio.get_running_loop()
        while True:
            await self._send_past()
            if clock.time() >= next_frame_s:
                sent_number = await self._send_newest(sent_number)
                next_frame_s = clock.time() + 1 / FRAMES_HZ
            try:
                async with asyncio.timeout_at(next_frame_s):
                    await self._wants.wait()
            except TimeoutError:
                continue

    async def _send_past(self) -> None:
        self._wants.clear()
        wanted_s, self._wanted_s = self._wanted_s, None
        text = None if wanted_s is None else self._feed.past(wanted_s)
        if text is not None:
            await self._socket.send_text(f'{{"kind":"past","frame":{text}}}')

    async def _send_newest(self, sent_number: int) -> int:
        """Returns the number of the frame that it has now."""
        newest = self._feed.newest(sent_number)
        if newest is None:
            return sent_number
        times = f'"first_s":{newest.first_s},"last_s":{newest.last_s},"age_s":{newest.age_s:.3f}'
        await self._socket.send_text(f'{{"kind":"frame",{times},"frame":{newest.text}}}')
        return newest.number

    async def _receive(self) -> None:
        while True:
            message = await self._socket.receive()
            if message["type"] == "websocket.disconnect":
                raise WebSocketDisconnect(message.get("code") or 1005)
            self._take(_parsed(message.get("text")))
            await asyncio.sleep(1 / MESSAGES_HZ)

    def _take(self, message: dict[str, Any]) -> None:
        """What is neither a word nor a time is ignored."""
        word, seek_s = message.get("word"), message.get("seek")
        if isinstance(word, str):
            self._feed.say(word)
        if isinstance(seek_s, float) and math.isfinite(seek_s):
            self._wanted_s = seek_s
            self._wants.set()


def _parsed(text: str | None) -> dict[str, Any]:
    """Integers become floats; empty for what is no JSON object."""
    try:
        message = json.loads(text or "", parse_int=float)
    except (ValueError, RecursionError):
        return {}
    return message if isinstance(message, dict) else {}
