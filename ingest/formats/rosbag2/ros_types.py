"""Definitions of ROS 2 types: those of a bag, and through the optional rosbags those that it leaves out."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Any

ENCODINGS = ("ros2msg", "ros2idl")
_INSTALL = "install the optional library: pip install 'flysid[bags]'"


@dataclass(frozen=True)
class Definition:
    """A definition, where it came from if not from the bag, why there is none, and its language."""

    text: str
    source: str = ""
    fault: str = ""
    encoding: str = "ros2msg"


def find_definition(kind: str, encoding: str, text: str) -> Definition:
    """The definition of type `kind`, from what the bag holds (both "" where that is nothing).

    Types that the bag leaves out need rosbags.
    """
    if encoding in ENCODINGS:
        return Definition(text, encoding=encoding)
    if not _has_rosbags():
        return Definition("", fault=f"no definition of {kind} in the bag; {_INSTALL}")
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
