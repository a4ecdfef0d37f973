"""The live page's stream: what a link brings, as server-sent events."""

from __future__ import annotations

import asyncio
import json
from collections.abc import AsyncIterator, Mapping
from typing import Any, Protocol

import msgspec

EVERY_S = 0.1
STATE_EVERY = 10  # of these steps the links and the file are told about once


class Live(Protocol):
    """What is recorded and watched while the page looks on (`flysid.live.session.Session`)."""

    def describe(self) -> dict[str, Any]: ...

    def state(self) -> dict[str, Any]: ...

    def news(self, seen: Mapping[str, int]) -> tuple[dict[str, Any], dict[str, int]]: ...


async def stream(live: Live, seen: Mapping[str, int], leaving: asyncio.Event) -> AsyncIterator[str]:
    """Events until the browser goes; see `event_text`."""
    from starlette.concurrency import run_in_threadpool

    step = 0
    while not leaving.is_set():
        text, seen = await run_in_threadpool(event_text, live, seen, step)
        if text:
            yield text
        step += 1
        await asyncio.sleep(EVERY_S)


def event_text(live: Live, seen: Mapping[str, int], step: int) -> tuple[str, Mapping[str, int]]:
    """The events of a step: `state` once a second, `news` if there are any; and what is seen then."""
    text = f"event: state\ndata: {_text(live.state())}\n\n" if step % STATE_EVERY == 0 else ""
    news, known = live.news(seen)
    if known != seen:
        text += f"id: {json.dumps(known)}\nevent: news\ndata: {_text(news)}\n\n"
    return text, known


def seen_by(header: str) -> dict[str, int]:
    """What a browser that comes back has seen, by its `Last-Event-ID`; nothing if that cannot be read."""
    try:
        return msgspec.json.decode(header[:4096], type=dict[str, int])
    except (msgspec.DecodeError, msgspec.ValidationError):
        return {}


def _text(content: object) -> str:
    return msgspec.json.encode(content).decode()
