"""A topic, as every container of messages states it: its name, its encoding, its definition."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Schema:
    """How a message is laid out: `encoding` is "ros1msg", "ros2msg", "protobuf", "jsonschema" ..."""

    name: str
    encoding: str
    data: bytes


@dataclass(frozen=True)
class Channel:
    """A topic with its schema; `encoding` is "ros1", "cdr", "protobuf", "json" ...

    `fault` says why its messages cannot be decoded, where the container's reader knows.
    """

    topic: str
    encoding: str
    schema: Schema | None
    fault: str = ""
