"""Small logs of a gyro, as the firmwares write them: blackbox, DataFlash and ULog."""

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence

import numpy as np

from flysid.dataset import FloatArray
from flysid.ingest.formats.blackbox.writing import Fields, Writer, unsigned_vb
from tests.samplelogs import dataflash, ulog

BETAFLIGHT = {
    "Firmware type": "Cleanflight",
    "Firmware revision": "Betaflight 4.5.1 (77d01ba3b) STM32F7X2",
    "minthrottle": "1070",
    "gyro_scale": "0x3f800000",
    "motorOutput": "158,2047",
    "acc_1G": "2048",
    "vbatref": "2490",
    "looptime": "125",
    "pid_process_denom": "2",
    "blackbox_high_resolution": "1",
    "gyro_lpf1_type": "0",
    "gyro_lpf1_static_hz": "250",
    "gyro_lpf1_dyn_hz": "0,500",
    "gyro_lpf2_type": "0",
    "gyro_lpf2_static_hz": "0",
    "gyro_notch_hz": "0,0",
    "gyro_notch_cutoff": "0,0",
    "features": "0",
}


def blackbox(
    settings: Mapping[str, str], columns: Mapping[str, Sequence[int]], time_us: Sequence[int], every: int = 1
) -> bytes:
    """A log of I frames; the iterations between two rows are `every`."""
    names = ["loopIteration", "time", *columns]
    signed = [0, 0] + [1] * len(columns)
    kinds = {
        "I": Fields(names, signed, [0] * len(names), [1, 1] + [0] * len(columns)),
        "P": Fields(names, signed, [0] * len(names), [1, 1] + [0] * len(columns)),
        "S": Fields(["flightModeFlags", "stateFlags"], [0, 0], [0, 0], [1, 1]),
    }
    writer = Writer(kinds, {"I interval": str(every), "P interval": f"1/{every}", **settings})
    out = [*writer.header(), b"E\x00" + unsigned_vb(time_us[0]), writer.frame("S", [1, 0])]
    rows = np.stack([np.asarray(values) for values in columns.values()], axis=1).tolist()
    for k, (row, stamp) in enumerate(zip(rows, time_us, strict=True)):
        out.append(writer.frame("I", [k * every, int(stamp), *row]))
    return b"".join([*out, b"E\xffEnd of log\x00"])


def ulog_file(topics: Mapping[str, tuple[str, Sequence[bytes]]], parameters: Mapping[str, float]) -> bytes:
    """A ULog: name of a topic -> its fields behind the timestamp, and its payloads."""
    parts = [ulog.HEAD, ulog.record("B", bytes(40))]
    for name, (fields, _) in topics.items():
        parts.append(ulog.record("F", f"{name}:uint64_t timestamp;{fields}".encode()))
    parts.append(ulog.record("I", ulog.named("char[3] sys_name", b"PX4")))
    for name, value in parameters.items():
        parts.append(ulog.record("P", ulog.named(f"float {name}", struct.pack("<f", value))))
    parts += [ulog.subscribe(k, 0, name) for k, name in enumerate(topics)]
    rows = sorted(
        (struct.unpack_from("<Q", payload)[0], k, payload)
        for k, (_, payloads) in enumerate(topics.values())
        for payload in payloads
    )
    parts += [ulog.data(k, payload) for _, k, payload in rows]
    return b"".join(parts)


DATAFLASH = {
    40: ("PARM", "QNff", "TimeUS,Name,Value,Default"),
    41: ("GYR", "QBQfff", "TimeUS,I,SampleUS,GyrX,GyrY,GyrZ"),
    42: ("ISBH", "QHBBHHQf", "TimeUS,N,type,instance,mul,smp_cnt,SampleUS,smp_rate"),
    43: ("ISBD", "QHHaaa", "TimeUS,N,seqno,x,y,z"),
    44: ("CTUN", "Qff", "TimeUS,ThI,ThO"),
    45: ("VIBE", "QBfffI", "TimeUS,IMU,VibeX,VibeY,VibeZ,Clip"),
    46: ("ESC", "QBf", "TimeUS,Instance,RPM"),
    47: ("IMU", "QBffffffIIfBBHH", "TimeUS,I,GyrX,GyrY,GyrZ,AccX,AccY,AccZ,EG,EA,T,GH,AH,GHz,AHz"),
}
"""Formats of messages that logs of a gyro need, as ArduCopter 4.5 defines them, without unused fields."""
KEYS = {41: "s#sEEE", 45: "s#----", 46: "s#-", 47: "s#-------------"}


def dataflash_file(
    rows: Sequence[tuple[int, int, Sequence[object]]], parameters: Mapping[str, float]
) -> bytes:
    """A DataFlash log: (number, time in us, values behind the time) each."""
    own = {name for name, _, _ in DATAFLASH.values()}
    types = {n: row for n, row in dataflash.TYPES.items() if row[0] not in own} | DATAFLASH
    out = [dataflash.fmt(number, types) for number in types if number not in (42, 43)]
    out += [_fmt_with_arrays(number) for number in (42, 43)]
    out += [
        dataflash.pack(129, 1, ord(i), label) for i, label in (("s", "s"), ("E", "rad/s"), ("#", "instance"))
    ]
    out += [dataflash.pack(131, 1, ord(i), factor) for i, factor in (("F", 1e-6), ("-", 0.0))]
    out += [
        dataflash.pack(130, 1, number, keys, "F" + "-" * (len(keys) - 1)) for number, keys in KEYS.items()
    ]
    out.append(dataflash.pack(12, 1, "ArduCopter V4.5.7 (0123abcd)"))
    for name, value in parameters.items():
        out.append(dataflash.pack(40, 2, name, value, value, types=types))
    for number, stamp, values in sorted(rows, key=lambda row: row[1]):
        out.append(_packed(number, stamp, values))
    return b"".join(out)


CODES = dataflash.CODES | {"a": "64s"}


def _fmt_with_arrays(number: int) -> bytes:
    name, form, labels = DATAFLASH[number]
    length = 3 + struct.calcsize("<" + "".join(CODES[c] for c in form))
    return dataflash.pack(128, number, length, name, form, labels)


def _packed(number: int, stamp: int, values: Sequence[object]) -> bytes:
    form = DATAFLASH[number][1]
    raw = [v.encode() if isinstance(v, str) else v for v in (stamp, *values)]
    return b"\xa3\x95" + bytes([number]) + struct.pack("<" + "".join(CODES[c] for c in form), *raw)


def shaken(
    seconds: float, rate_hz: float, tones: Sequence[tuple[float, float]], noise: float, seed: int
) -> tuple[FloatArray, FloatArray]:
    """Times and a rate in deg/s: tones of (Hz, size) and white noise, over what a vehicle does itself."""
    rng = np.random.default_rng(seed)
    t = np.arange(round(seconds * rate_hz)) / rate_hz
    x = 20.0 * np.sin(2.0 * np.pi * 0.7 * t) + 8.0 * np.sin(2.0 * np.pi * 2.3 * t + 1.0)
    for hz, size in tones:
        x = x + size * np.sin(2.0 * np.pi * hz * t + rng.uniform(0.0, 6.0))
    return t, x + rng.normal(0.0, noise, len(t))
