"""Definitions of ROS 2 types that a bag does not carry as message text, through the optional rosbags."""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import cache
from typing import Any

MAX_IDL_BYTES = 1 << 20
_NEXT = re.compile(r"^={3,}[ \t]*$", re.MULTILINE)
_HEAD = re.compile(r"^\s*IDL: .*$", re.MULTILINE)
_INSTALL = "install the optional library: pip install 'flysid[bags]'"


@dataclass(frozen=True)
class Definition:
    """A definition as message text, where it came from if not from the bag, and why there is none."""

    text: str
    source: str = ""
    fault: str = ""


def find_definition(kind: str, encoding: str, text: str) -> Definition:
    """The definition of type `kind`, from what the bag holds (both "" where that is nothing).

    IDL and types that the bag leaves out need rosbags.
    """
    if encoding == "ros2msg":
        return Definition(text)
    if not _has_rosbags():
        what = "a definition in IDL" if encoding == "ros2idl" else f"no definition of {kind} in the bag"
        return Definition("", fault=f"{what}; {_INSTALL}")
    if encoding == "ros2idl":
        return _from_idl(kind, text)
    return _known(kind)


def _has_rosbags() -> bool:
    try:
        import rosbags.typesys  # noqa: F401
    except ImportError:
        return False
    return True


@cache
def _store() -> Any:
    from rosbags.typesys import Stores, get_typestore

    return get_typestore(Stores.ROS2_HUMBLE)


@cache
def _known(kind: str) -> Definition:
    """A type of a plain ROS 2 Humble installation."""
    store = _store()
    if kind not in store.fielddefs:
        return Definition("", fault=f"no definition of {kind} in the bag, and ROS 2 Humble has none")
    return Definition(store.generate_msgdef(kind, ros_version=2)[0], "ROS 2 Humble, by rosbags")


def _from_idl(kind: str, text: str) -> Definition:
    """IDL as message text."""
    from rosbags.typesys import Stores, TypesysError, get_types_from_idl, get_typestore

    if len(text) > MAX_IDL_BYTES:
        return Definition("", fault=f"an IDL definition of {len(text)} bytes")
    try:
        store = get_typestore(Stores.EMPTY)
        types: dict[str, Any] = {}
        for part in _NEXT.split(text):
            if (body := _HEAD.sub("", part)).strip():
                types.update(get_types_from_idl(body))
        store.register(types)
        return Definition(store.generate_msgdef(kind, ros_version=2)[0], "IDL, by rosbags")
    except (TypesysError, KeyError, ValueError, RecursionError) as error:
        return Definition("", fault=f"the IDL definition of {kind} cannot be read: {str(error)[:80]}")
