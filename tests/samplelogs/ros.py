"""ROS definitions, random messages of them and their bytes, through the mcap libraries' own encoders."""

from __future__ import annotations

import io
import warnings
from typing import Any

import numpy as np

HEADER_1 = "uint32 seq\ntime stamp\nstring frame_id\n"
HEADER_2 = "builtin_interfaces/Time stamp\nstring frame_id\n"
POSE = "Point position\nQuaternion orientation\n"
POINT = "float64 x\nfloat64 y\nfloat64 z\n"
QUATERNION = "float64 x\nfloat64 y\nfloat64 z\nfloat64 w\n"
_LINE = "=" * 80


def definition(text: str, **needed: str) -> str:
    """A concatenated definition; a double underscore in a name stands for the slash."""
    parts = [text]
    for name, body in needed.items():
        parts.append(f"{_LINE}\nMSG: {name.replace('__', '/')}\n{body}")
    return "\n".join(parts)


POSE_STAMPED_1 = definition(
    "Header header\nPose pose\n",
    std_msgs__Header=HEADER_1,
    geometry_msgs__Pose=POSE,
    geometry_msgs__Point=POINT,
    geometry_msgs__Quaternion=QUATERNION,
)
POSE_STAMPED_2 = definition(
    "std_msgs/Header header\ngeometry_msgs/Pose pose\n",
    std_msgs__Header=HEADER_2,
    geometry_msgs__Pose=POSE,
    geometry_msgs__Point=POINT,
    geometry_msgs__Quaternion=QUATERNION,
    builtin_interfaces__Time="int32 sec\nuint32 nanosec\n",
)
# every kind of field, in an order that makes CDR pad
MIXED = """
bool flag
int8 a
uint8 b
# a comment
int16 c
uint16 d
uint8 CONSTANT=3
string label
int32 e
uint32 f
uint8 g
int64 h
uint64 i
float32 j
bool[3] flags
float64 k
float32[] floats
string[] words
uint8 l
float64[] doubles
uint8[] blob
int16[5] five
pkg/Inner inner
pkg/Inner[] inners
pkg/Even[] evens
pkg/Even[2] pair
bool[] many
string[2] names
"""
INNER = "uint8 kind\nstring text\nfloat64 value\nint16[] data\n"
EVEN = "float64 x\nuint8 y\n"
MIXED_ALL = definition(MIXED, pkg__Inner=INNER, pkg__Even=EVEN)


def inner(rng: np.random.Generator) -> dict[str, Any]:
    return {
        "kind": int(rng.integers(256)),
        "text": words(rng),
        "value": float(rng.normal()),
        "data": rng.integers(-999, 999, rng.integers(4)).tolist(),
    }


def words(rng: np.random.Generator) -> str:
    return "".join(rng.choice(list("abc déπ")) for _ in range(rng.integers(7)))


def even(rng: np.random.Generator) -> dict[str, Any]:
    return {"x": float(rng.normal()), "y": int(rng.integers(256))}


def mixed(rng: np.random.Generator) -> dict[str, Any]:
    """One random message of MIXED_ALL."""
    return {
        "flag": bool(rng.integers(2)),
        "a": int(rng.integers(-128, 128)),
        "b": int(rng.integers(256)),
        "c": int(rng.integers(-999, 999)),
        "d": int(rng.integers(65536)),
        "label": words(rng),
        "e": int(rng.integers(-(2**31), 2**31)),
        "f": int(rng.integers(2**32)),
        "g": int(rng.integers(256)),
        "h": int(rng.integers(-(2**63), 2**63 - 1)),
        "i": int(rng.integers(2**63)) * 2,
        "j": float(np.float32(rng.normal())),
        "flags": [bool(v) for v in rng.integers(0, 2, 3)],
        "k": float(rng.choice([rng.normal(), np.nan, np.inf])),
        "floats": [float(np.float32(v)) for v in rng.normal(size=rng.integers(5))],
        "words": [words(rng) for _ in range(rng.integers(4))],
        "l": int(rng.integers(256)),
        "doubles": rng.normal(size=rng.integers(4)).tolist(),
        "blob": rng.bytes(int(rng.integers(9))),
        "five": rng.integers(-999, 999, 5).tolist(),
        "inner": inner(rng),
        "inners": [inner(rng) for _ in range(rng.integers(4))],
        "evens": [even(rng) for _ in range(rng.integers(4))],
        "pair": [even(rng), even(rng)],
        "many": [bool(v) for v in rng.integers(0, 2, rng.integers(5))],
        "names": [words(rng), words(rng)],
    }


def encode_ros2(kind: str, text: str, message: dict[str, Any]) -> bytes:
    """CDR bytes of a message, by mcap-ros2-support."""
    from mcap_ros2._dynamic import serialize_dynamic

    return bytes(serialize_dynamic(kind, text)[kind](message))


def ros1_types(kind: str, text: str) -> dict[str, Any]:
    """Message classes of a ROS 1 definition, by mcap-ros1-support."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        from mcap_ros1._vendor.genpy import dynamic

        types: dict[str, Any] = dynamic.generate_dynamic(kind, text)  # type: ignore[no-untyped-call]
    return types


def encode_ros1(types: dict[str, Any], kind: str, message: dict[str, Any]) -> bytes:
    """ROS 1 bytes of a message of one of `types`."""
    out = io.BytesIO()
    _filled(types, types[kind], message).serialize(out)
    return out.getvalue()


def _filled(types: dict[str, Any], cls: Any, message: dict[str, Any]) -> Any:
    instance = cls()
    for name, kind in zip(cls.__slots__, cls._slot_types, strict=True):
        value = message[name]
        base = kind.partition("[")[0]
        if base in ("time", "duration"):
            getattr(instance, name).secs = value["secs"]
            getattr(instance, name).nsecs = value["nsecs"]
            continue
        if isinstance(value, dict):
            value = _filled(types, types[base], value)
        elif isinstance(value, list) and value and isinstance(value[0], dict):
            value = [_filled(types, types[base], v) for v in value]
        setattr(instance, name, value)
    return instance


def plain(value: Any) -> Any:
    """A decoded message of either library as dictionaries and lists, to compare."""
    if isinstance(value, bytes | bytearray):
        return list(value)
    if isinstance(value, list | tuple):
        return [plain(v) for v in value]
    names = getattr(value, "__slots__", None)
    if names is not None:
        return {name: plain(getattr(value, name)) for name in names}
    return value


def dotted(message: dict[str, Any], path: str = "") -> dict[str, Any]:
    """Nested dictionaries as dotted names; inside lists of messages the names start anew."""
    flat: dict[str, Any] = {}
    for name, value in message.items():
        here = f"{path}.{name}" if path else name
        if isinstance(value, dict):
            flat.update(dotted(value, here))
        elif isinstance(value, list) and value and isinstance(value[0], dict):
            flat[here] = [dotted(v) for v in value]
        else:
            flat[here] = value
    return flat
