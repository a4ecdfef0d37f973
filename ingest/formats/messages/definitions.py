"""ROS message definitions (ros1msg, ros2msg) as trees of types.

A definition is the text of a .msg file, then, after lines of `=`, `MSG: package/Type` and the text of every
type it refers to. Constants and default values do not change the layout and are left out. Of comments, a unit
in brackets is kept (`float32 vx  # [m/s] ...`).
Definitions come from the log, so they are hostile: types may recurse or blow up (A holds ten B, B ten C ...);
both end in DefinitionError. Of a service the event that its introspection publishes is made up, of an action
the message of its feedback: their definitions are the files of the service and of the action.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field

from flysid.ingest.formats.common.units import is_known

MAX_LEAVES = 20_000
MAX_DEPTH = 24
MAX_ARRAY = 1 << 24


class DefinitionError(ValueError):
    """A definition that gives no layout; the message says why."""


@dataclass(frozen=True)
class Number:
    """A fixed-size value; `dtype` without byte order, e.g. "f8", "b1" (one byte, not zero means true)."""

    dtype: str


@dataclass(frozen=True)
class Text:
    """A string: u32 length, bytes (in CDR with a NUL that the length counts); a wide one: see `Wide`."""

    is_wide: bool = False


@dataclass(frozen=True)
class MessageType:
    """A message type: named fields in order, and units by name where comments state them."""

    name: str
    fields: tuple[tuple[str, Type], ...]
    units: Mapping[str, str] = field(default_factory=dict, compare=False)


@dataclass(frozen=True)
class Array:
    """`size` elements, or a sequence with a u32 count where `size` is None."""

    element: Type
    size: int | None


Type = Number | Text | MessageType | Array

_COMMON: Mapping[str, str] = {
    "bool": "b1",
    "int8": "i1",
    "uint8": "u1",
    "int16": "i2",
    "uint16": "u2",
    "int32": "i4",
    "uint32": "u4",
    "int64": "i8",
    "uint64": "u8",
    "float32": "f4",
    "float64": "f8",
    "char": "u1",
}
ROS1_NUMBERS = {**_COMMON, "byte": "i1"}
ROS2_NUMBERS = {**_COMMON, "byte": "u1"}
_SECONDS = {
    "time": (("secs", Number("u4")), ("nsecs", Number("u4"))),
    "duration": (("secs", Number("i4")), ("nsecs", Number("i4"))),
}
_BUILTIN_ROS2 = {
    "builtin_interfaces/Time": "int32 sec\nuint32 nanosec",
    "builtin_interfaces/Duration": "int32 sec\nuint32 nanosec",
    "service_msgs/ServiceEventInfo": "uint8 event_type\nbuiltin_interfaces/Time stamp\nchar[16] client_gid\n"
    "int64 sequence_number",
    "unique_identifier_msgs/UUID": "uint8[16] uuid",
}
_STD_HEADER = "uint32 seq\ntime stamp\nstring frame_id"
_FIELD = re.compile(
    r"^(?P<type>[A-Za-z][\w/]*)(?:<=\d+)?(?P<array>\[(?:(?P<bound><=)?(?P<size>\d+))?\])?\s+(?P<name>[A-Za-z_]\w*)"
    r"\s*(?P<rest>.*)$"
)
_BRACKETS = re.compile(r"\[([^][]*)\]")
_PARTS = re.compile(r"^---[ \t]*$", re.MULTILINE)
_DERIVED = re.compile(r"_(?:Event|Request|Response|Goal|Result|Feedback|FeedbackMessage)$")
_HEAD = re.compile(r"(?:MSG|SRV|ACTION):\s*(?P<name>\S+)")
_NEXT = re.compile(r"^={3,}[ \t]*$", re.MULTILINE)


def parse_definition(name: str, text: str, ros: int) -> MessageType:
    """The layout of message `name` from its concatenated definition.

    Parameters
    ----------
    name : e.g. "geometry_msgs/PoseStamped" or "geometry_msgs/msg/PoseStamped".
    text : the definition and those it needs.
    ros : 1 or 2.

    Raises
    ------
    DefinitionError : a type is missing, unknown, recursive or too large.
    """
    return _Resolver(_split(name, text, ros), ros).record(_short(name), ())


def units_of(kind: Type, path: str = "", unit: str = "") -> Iterator[tuple[str, str]]:
    """Dotted path and unit, maybe "", of every column of numbers that a type gives."""
    if isinstance(kind, MessageType):
        for name, inner in kind.fields:
            yield from units_of(inner, f"{path}.{name}" if path else name, kind.units.get(name, ""))
    elif isinstance(kind, Number) or (isinstance(kind, Array) and isinstance(kind.element, Number)):
        yield path, unit


def _stated_unit(comment: str) -> str:
    """The unit in brackets; "" where none or several are known."""
    known = {text.strip() for text in _BRACKETS.findall(comment) if is_known(text.strip())} - {"", "1"}
    return known.pop() if len(known) == 1 else ""


def _split(name: str, text: str, ros: int) -> dict[str, str]:
    """Short name -> text of every definition in `text`."""
    texts = dict(_BUILTIN_ROS2) if ros == 2 else {"std_msgs/Header": _STD_HEADER}
    first, *others = _NEXT.split(text)
    _add(texts, _short(name), first)
    for other in others:
        head, _, body = other.strip().partition("\n")
        found = _HEAD.match(head)
        if found is not None:
            _add(texts, _short(found["name"]), body)
    return texts


def _add(texts: dict[str, str], name: str, text: str) -> None:
    """A definition; that of a service or an action as those of its messages."""
    parts = _PARTS.split(text)
    if len(parts) not in (2, 3):
        texts[name] = text
        return
    whole = _DERIVED.sub("", name)
    names = ("Request", "Response") if len(parts) == 2 else ("Goal", "Result", "Feedback")
    texts |= {f"{whole}_{part}": body for part, body in zip(names, parts, strict=True)}
    if len(parts) == 2:
        texts[f"{whole}_Event"] = (
            "service_msgs/ServiceEventInfo info\n"
            f"{whole}_Request[<=1] request\n{whole}_Response[<=1] response"
        )
    else:
        texts[f"{whole}_FeedbackMessage"] = f"unique_identifier_msgs/UUID goal_id\n{whole}_Feedback feedback"


def _short(name: str) -> str:
    """package/msg/Type -> package/Type."""
    parts = name.split("/")
    return f"{parts[0]}/{parts[-1]}" if len(parts) > 1 else name


class _Resolver:
    def __init__(self, texts: Mapping[str, str], ros: int) -> None:
        self._texts = texts
        self._ros = ros
        self._numbers = ROS1_NUMBERS if ros == 1 else ROS2_NUMBERS
        self._leaves = 0

    def record(self, name: str, above: tuple[str, ...]) -> MessageType:
        if name in above:
            raise DefinitionError(f"type {name} contains itself")
        if len(above) >= MAX_DEPTH:
            raise DefinitionError(f"types are nested more than {MAX_DEPTH} deep")
        if name not in self._texts:
            raise DefinitionError(f"type {name} is not defined")
        fields: list[tuple[str, Type]] = []
        units: dict[str, str] = {}
        for raw in self._texts[name].splitlines():
            line, _, comment = raw.partition("#")
            line = line.strip()
            found = self._field(line, name, (*above, name)) if line and not _HEAD.match(line) else None
            if found is not None:
                fields.append(found)
                units[found[0]] = _stated_unit(comment)
        if not fields and self._ros == 2:  # rosidl gives an empty message this member
            fields = [("structure_needs_at_least_one_member", Number("u1"))]
        return MessageType(name, tuple(fields), units)

    def _field(self, line: str, owner: str, above: tuple[str, ...]) -> tuple[str, Type] | None:
        """One line of a definition; None for a constant."""
        found = _FIELD.match(line)
        if found is None:
            raise DefinitionError(f"cannot read {line[:60]!r} in {owner}")
        if found["rest"].startswith("="):
            return None
        element = self._type(found["type"], owner, above)
        if found["array"] is None:
            return found["name"], element
        size = int(found["size"]) if found["size"] and not found["bound"] else None
        if size is not None and not 0 < size <= MAX_ARRAY:
            raise DefinitionError(f"array of {size} elements in {owner}")
        return found["name"], Array(element, size)

    def _type(self, name: str, owner: str, above: tuple[str, ...]) -> Type:
        self._leaves += 1
        if self._leaves > MAX_LEAVES:
            raise DefinitionError(f"more than {MAX_LEAVES} fields")
        if name in self._numbers:
            return Number(self._numbers[name])
        if name in ("string", "wstring"):
            return Text(is_wide=name == "wstring")
        if self._ros == 1 and name in _SECONDS:
            return MessageType(name, _SECONDS[name])
        return self.record(self._qualify(name, owner), above)

    def _qualify(self, name: str, owner: str) -> str:
        """A type name as written in `owner`, with its package."""
        if "/" in name:
            return _short(name)
        here = f"{owner.partition('/')[0]}/{name}"
        if here not in self._texts and name == "Header":
            return "std_msgs/Header"
        if here not in self._texts:
            same = [known for known in self._texts if known.endswith(f"/{name}") or known == name]
            return same[0] if len(same) == 1 else here
        return here
