"""The live page's stream: what a link brings, as server-sent events."""

from __future__ import annotations

import asyncio
import json
from collections.abc import AsyncIterator, Mapping
from typing import Any, Protocol

import msgspec
from starlette.concurrency import run_in_threadpool

EVERY_S = 0.1
STATE_EVERY = 10  # of these steps the links and the file are told about once


class Live(Protocol):
    """What is recorded and watched while the page looks on (`flysid.live.session.Session`)."""

    def describe(self) -> dict[str, Any]: ...

    def state(self) -> dict[str, Any]: ...

    def news(self, seen: Mapping[str, int]) -> tuple[dict[str, Any], dict[str, int]]: ...


async def stream(live: Live, seen: Mapping[str, int], leaving: asyncio.Event) -> AsyncIterator[str]:
    """Events until the browser goes: `state` once a second, `news` whenever there are any."""
    step = 0
    while not leaving.is_set():
        if step % STATE_EVERY == 0:
            state = await run_in_threadpool(live.state)
            yield f"event: state\ndata: {_text(state)}\n\n"
        news, known = live.news(seen)
        if known != seen:
            seen = known
            yield f"id: {json.dumps(known)}\nevent: news\ndata: {_text(news)}\n\n"
        step += 1
        await asyncio.sleep(EVERY_S)


def seen_by(header: str) -> dict[str, int]:
    """What a browser that comes back has seen, by its `Last-Event-ID`; nothing if that cannot be read."""
    try:
        return msgspec.json.decode(header[:4096], type=dict[str, int])
    except (msgspec.DecodeError, msgspec.ValidationError):
        return {}


def _text(content: object) -> str:
    return msgspec.json.encode(content).decode()
