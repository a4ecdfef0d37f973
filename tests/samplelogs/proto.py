"""A protobuf message with every kind of field, built without the compiler."""

from __future__ import annotations

from typing import Any


def sample_class() -> Any:
    """The class of `test.Sample`."""
    from google.protobuf.descriptor_pb2 import FieldDescriptorProto, FileDescriptorProto
    from google.protobuf.descriptor_pool import DescriptorPool
    from google.protobuf.message_factory import GetMessageClass

    kinds = FieldDescriptorProto
    file = FileDescriptorProto(name="sample.proto", package="test", syntax="proto3")
    mode = file.enum_type.add(name="Mode")
    for number, name in enumerate(["LANDED", "HOVER", "FLY"]):
        mode.value.add(name=name, number=number)
    _message(file, "Point", [("x", kinds.TYPE_DOUBLE), ("y", kinds.TYPE_FLOAT)])
    _message(file, "Time", [("seconds", kinds.TYPE_INT64), ("nanos", kinds.TYPE_INT32)])
    sample = _message(file, "Sample", [])
    entry = sample.nested_type.add(name="GainsEntry")
    entry.options.map_entry = True
    entry.field.add(name="key", number=1, type=kinds.TYPE_STRING, label=1)
    entry.field.add(name="value", number=2, type=kinds.TYPE_DOUBLE, label=1)
    for number, (name, kind, label, type_name) in enumerate(
        [
            ("stamp", kinds.TYPE_MESSAGE, 1, ".test.Time"),
            ("position", kinds.TYPE_MESSAGE, 1, ".test.Point"),
            ("name", kinds.TYPE_STRING, 1, ""),
            ("values", kinds.TYPE_FLOAT, 3, ""),
            ("mode", kinds.TYPE_ENUM, 1, ".test.Mode"),
            ("blob", kinds.TYPE_BYTES, 1, ""),
            ("path", kinds.TYPE_MESSAGE, 3, ".test.Point"),
            ("gains", kinds.TYPE_MESSAGE, 3, ".test.Sample.GainsEntry"),
            ("signed", kinds.TYPE_SINT64, 1, ""),
            ("fixed", kinds.TYPE_FIXED32, 1, ""),
            ("flag", kinds.TYPE_BOOL, 1, ""),
            ("words", kinds.TYPE_STRING, 3, ""),
            ("counts", kinds.TYPE_INT32, 3, ""),
            ("next", kinds.TYPE_MESSAGE, 1, ".test.Sample"),
        ],
        start=1,
    ):
        sample.field.add(name=name, number=number, type=kind, label=label, type_name=type_name or None)
    pool = DescriptorPool()
    pool.Add(file)
    return GetMessageClass(pool.FindMessageTypeByName("test.Sample"))


def flight_class() -> Any:
    """The class of `test.Flight`: a stamp, a string, two nested points and a packed sequence."""
    from google.protobuf.descriptor_pb2 import FieldDescriptorProto, FileDescriptorProto
    from google.protobuf.descriptor_pool import DescriptorPool
    from google.protobuf.message_factory import GetMessageClass

    kinds = FieldDescriptorProto
    file = FileDescriptorProto(name="flight.proto", package="test", syntax="proto3")
    _message(file, "Point", [(axis, kinds.TYPE_DOUBLE) for axis in "xyz"])
    _message(file, "Time", [("seconds", kinds.TYPE_INT64), ("nanos", kinds.TYPE_INT32)])
    flight = _message(file, "Flight", [])
    own = [("stamp", ".test.Time"), ("rotation", ".test.Point"), ("velocity", ".test.Point")]
    for number, (name, type_name) in enumerate(own, start=1):
        flight.field.add(name=name, number=number, type=kinds.TYPE_MESSAGE, label=1, type_name=type_name)
    flight.field.add(name="frame", number=4, type=kinds.TYPE_STRING, label=1)
    flight.field.add(name="motors", number=5, type=kinds.TYPE_FLOAT, label=3)
    pool = DescriptorPool()
    pool.Add(file)
    return GetMessageClass(pool.FindMessageTypeByName("test.Flight"))


def _message(file: Any, name: str, fields: list[tuple[str, int]]) -> Any:
    message = file.message_type.add(name=name)
    for number, (field, kind) in enumerate(fields, start=1):
        message.field.add(name=field, number=number, type=kind, label=1)
    return message


def sample_message(cls: Any, k: int) -> Any:
    """The k-th message; every third leaves out what it can."""
    message = cls()
    message.stamp.seconds = 100 + k
    message.stamp.nanos = 7
    if k % 3:
        message.position.x = k / 3
        message.name = f"number {k} é"
        message.values.extend([0.5 * k] * (k % 4))
        message.mode = k % 3
        message.blob = bytes([k]) * (k % 5)
        for j in range(k % 3):
            message.path.add(x=j, y=-j)
        message.gains["p"] = k
        message.signed = -k * 10**12
        message.fixed = k
        message.flag = bool(k % 2)
        message.words.extend(["a", "bc"][: k % 3])
        message.counts.extend([-k, k])
        message.next.name = "inside"
    return message
