"""Telemetry logs of several senders whose parameters are packed in two ways: every value must come back."""

from __future__ import annotations

import random
import struct
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from flysid.flight import Flight
from flysid.ingest.formats.base import Limits, collect
from flysid.ingest.formats.registry import find_format
from soak import Outcome

BITS = {1: (0, 8), 2: (1, 8), 3: (0, 16), 4: (1, 16), 5: (0, 32), 6: (1, 32)}
FORMATS = {1: "<Bxxx", 2: "<bxxx", 3: "<Hxx", 4: "<hxx", 5: "<I", 6: "<i", 9: "<f"}
REAL32 = 9
WAYS = ("capabilities", "autopilot", "evidence")
STATION = (255, 190)
EXACT = 1 << 24  # whole numbers that a float holds


class _Sink:
    """What pymavlink writes to."""

    def __init__(self) -> None:
        self.data = b""

    def write(self, data: bytes) -> None:
        self.data = bytes(data)


@dataclass
class Sender:
    """A component with its parameters.

    Attributes
    ----------
    in_bytes : whether integers are copied, not converted.
    way : how a reader can know that.
    """

    system: int
    component: int
    in_bytes: bool
    way: str
    values: dict[str, tuple[float, int]] = field(default_factory=dict)

    def packed(self, value: float, kind: int) -> float:
        """A value as the message's float."""
        if self.in_bytes and kind != REAL32:
            return float(struct.unpack("<f", struct.pack(FORMATS[kind], int(value)))[0])
        return value


@dataclass
class Trial:
    """A log and its senders; `was_set` are the parameters that a ground station set, by name."""

    seed: int
    blob: bytes
    senders: list[Sender]
    was_set: dict[str, float]


def _value(rng: random.Random, kind: int, in_bytes: bool) -> float:
    """A parameter's value of a type; as the encoding can hold it."""
    if kind == REAL32:
        return float(struct.unpack("<f", struct.pack("<f", rng.uniform(-100, 100)))[0])
    signed, bits = BITS[kind]
    top = (1 << (bits - signed)) - 1
    low = -top - 1 if signed else 0
    if not in_bytes:
        low, top = max(low, -EXACT), min(top, EXACT)
    value = rng.choice((rng.randint(low, top), rng.randint(max(low, -9), min(top, 5000)), 0))
    raw = struct.pack(FORMATS[kind], value)
    survives = struct.pack("<f", *struct.unpack("<f", raw)) == raw  # pymavlink alters NaNs that signal
    return float(value if survives or not in_bytes else 0)


def draw(seed: int) -> Trial:
    """The log that a seed draws."""
    rng = random.Random(seed)
    systems = rng.sample(range(1, 200), rng.randint(1, 3))
    senders = [Sender(s, 1, rng.random() < 0.5, rng.choice(WAYS)) for s in systems]
    if rng.random() < 0.4:  # a gimbal or camera that names no autopilot and packs in its own way
        senders.append(Sender(systems[0], 154, rng.random() < 0.5, "evidence"))
    messages: list[tuple[Sender | None, Any]] = []
    was_set = {}
    for sender in senders:
        messages += [(sender, message) for message in _told(sender)]
        for k in range(rng.randint(2, 12)):
            kind = rng.choice(tuple(FORMATS))
            name = f"P{sender.system}_{sender.component}_{k}"
            value = _value(rng, kind, sender.in_bytes)
            sender.values[name] = (value, kind)
            packed = sender.packed(value, kind)
            messages.append((sender, mavlink.MAVLink_param_value_message(name.encode(), packed, kind, 12, k)))
            if sender.way != "evidence" and rng.random() < 0.3:
                new = _value(rng, kind, sender.in_bytes)
                was_set[name] = new
                where = (sender.system, sender.component)
                packed = sender.packed(new, kind)
                messages.append(
                    (None, mavlink.MAVLink_param_set_message(*where, name.encode(), packed, kind))
                )
        if sender.way == "evidence":  # one value that shows it
            name = f"P{sender.system}_{sender.component}_shown"
            sender.values[name] = (4001.0, 6)
            packed = sender.packed(4001.0, 6)
            messages.append((sender, mavlink.MAVLink_param_value_message(name.encode(), packed, 6, 12, 99)))
    rng.shuffle(messages)
    told = [((s.system, s.component) if s is not None else STATION, message) for s, message in messages]
    return Trial(seed, written(told), senders, was_set)


def _told(sender: Sender) -> Iterator[Any]:
    """Messages in which a component says how it packs parameters."""
    mine = mavlink.MAV_AUTOPILOT_PX4 if sender.in_bytes else mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA
    other = mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA if sender.in_bytes else mavlink.MAV_AUTOPILOT_PX4
    if sender.component != 1:
        yield mavlink.MAVLink_heartbeat_message(26, mavlink.MAV_AUTOPILOT_INVALID, 0, 0, 4, 3)
        return
    autopilot = {"capabilities": other, "autopilot": mine, "evidence": mavlink.MAV_AUTOPILOT_GENERIC}[
        sender.way
    ]
    yield mavlink.MAVLink_heartbeat_message(2, autopilot, 0, 0, 4, 3)
    if sender.way == "capabilities":
        can = 16 if sender.in_bytes else 131_072
        empty = [0] * 8
        yield mavlink.MAVLink_autopilot_version_message(can | 2, 0, 0, 0, 0, empty, empty, empty, 0, 0, 0)


def written(messages: Sequence[tuple[tuple[int, int], Any]]) -> bytes:
    """A tlog of messages, each with its (system, component), 20 ms apart."""
    links: dict[tuple[int, int], tuple[Any, _Sink]] = {}
    blob = b""
    for k, (key, message) in enumerate(messages):
        if key not in links:
            sink = _Sink()
            links[key] = (mavlink.MAVLink(sink, *key), sink)
        link, sink = links[key]
        link.send(message)
        blob += struct.pack(">Q", 1_700_000_000_000_000 + 20_000 * k) + sink.data
    return blob


def faults(trial: Trial) -> Iterator[str]:
    """Values that do not come back."""
    flight = collect(memoryview(trial.blob), "t.tlog", find_format("tlog"), Limits())
    for sender in trial.senders:
        meant = {name: value for name, (value, _) in sender.values.items()}
        got = values_in(flight, f"{sender.system}.{sender.component}/PARAM_VALUE")
        wrong = [
            f"{name} {got.get(name)}, not {value}" for name, value in meant.items() if got.get(name) != value
        ]
        if wrong:
            yield f"{sender.system}.{sender.component} ({sender.way}, bytes {sender.in_bytes}): {wrong[0]}"
    if trial.was_set:
        got = values_in(flight, "255.190/PARAM_SET")
        wrong = [f"{n} {got.get(n)}, not {v}" for n, v in trial.was_set.items() if got.get(n) != v]
        if wrong:
            yield f"set: {wrong[0]}"


def values_in(flight: Flight, stream: str) -> dict[str, float]:
    """Parameters of a stream by name."""
    table = flight[stream]
    return dict(zip(table["param_id"].to_pylist(), table["param_value"].to_pylist(), strict=True))


def _values(trial: Trial) -> int:
    return sum(len(sender.values) for sender in trial.senders)


def trials(count: int, goes_on: Callable[[], bool], first_seed: int = 0) -> Outcome:
    """Draw and judge logs, one seed each."""
    outcome = Outcome("telemetry")
    outcome.judge(range(first_seed, first_seed + count), goes_on, draw, faults, _values)
    return outcome
