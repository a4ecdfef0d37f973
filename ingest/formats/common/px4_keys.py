"""Fields of PX4's topics that tell several things apart, as schema metadata.

PX4 gives most sensors, batteries and estimators an instance of their topic each. These topics have one.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping

from flysid.flight import KEY, KEY_IF_SEVERAL

KEYS: Mapping[str, str] = {
    "debug_array": "name",
    "debug_key_value": "key",
    "debug_value": "ind",
    "debug_vect": "name",
}
KEYS_IF_SEVERAL: Mapping[str, str] = {
    "battery_status": "id",
    "can_interface_status": "interface",
    "transponder_report": "icao_address",
}
"""Of topics that have instances as well, which share a name over ROS 2, or most often one thing."""


def px4_key(topic: str, fields: Collection[str]) -> dict[str, str]:
    """The key of a topic with these fields, as schema metadata; empty where it has none."""
    found = {KEY: KEYS.get(topic, ""), KEY_IF_SEVERAL: KEYS_IF_SEVERAL.get(topic, "")}
    return {kind: field for kind, field in found.items() if field in fields}
