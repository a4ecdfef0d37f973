"""One flight as the instruments saw it: what the writers of logs take.

Axes and signs are the paper's: x forward, y to the right, z up, heading 0; theta positive nose down (which
flies forward), phi positive right side down; angles in degrees, velocities in m/s. Each writer turns them
into the signs of its format. Times are integer nanoseconds on the vehicle's clock.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from flysid.dataset import FloatArray

IntArray = npt.NDArray[np.int64]
BoolArray = npt.NDArray[np.bool_]

MS_NS = 1_000_000

# A radio link that works: 6 ms at best, and a tail of a few ms more (exponential, mean 4 ms).


@dataclass(frozen=True, eq=False)
class Telemetry:
    """Named values, each (N,), at (N,) times in nanoseconds of the vehicle's clock."""

    time_ns: IntArray
    values: Mapping[str, FloatArray]

    def __getitem__(self, name: str) -> FloatArray:
        return self.values[name]

    def __len__(self) -> int:
        return len(self.time_ns)


@dataclass(frozen=True, eq=False)
class Recording:
    """What a flight left behind before any format writes it down.

    `name`: of the flight; the log's file name without its suffix.
    `boot_utc_ns`: UTC of vehicle time zero.
    `command`: theta_in, phi_in (deg), vz_in (m/s), as sent.
    `state`: measured vx, vy, vz (m/s), x, y, z (m), theta, phi, psi (deg); and, where the vehicle has rotors,
        p, q, r (deg/s), thrust (lift over the lift of hover) and the efforts of `rigid_body.Trajectory`.
    `truth`: the same without sensor errors.
    `seed`: of the link's jitter.
    `lost`: [start, end) vehicle times in nanoseconds during which nothing reached the recorder.
    `system`: the vehicle's number in its fleet.
    `start_height_m`: height of z = 0 above the ground.
    """

    name: str
    boot_utc_ns: int
    command: Telemetry
    state: Telemetry
    truth: Telemetry
    seed: int = 0
    lost: tuple[tuple[int, int], ...] = ()
    system: int = 1
    start_height_m: float = 20.0


def in_sending_order(*times_ns: IntArray) -> tuple[IntArray, IntArray, IntArray]:
    """Messages of several sources in the order they are sent: (time, source, row in its source), each (N,).

    Messages that are due at once are sent in the order of their sources.
    """
    due = np.concatenate(times_ns)
    source = np.repeat(np.arange(len(times_ns)), [len(t) for t in times_ns])
    row = np.concatenate([np.arange(len(t)) for t in times_ns])
    order = np.lexsort((source, due))
    return due[order], source[order], row[order]


def as_bytes(rows: npt.NDArray[np.void]) -> list[bytes]:
    """The bytes of each record of a contiguous array, gaps between fields included."""
    blob = rows.view(np.uint8).tobytes()
    size = rows.dtype.itemsize
    return [blob[i : i + size] for i in range(0, len(blob), size)]


def throttle(recording: Recording, time_ns: IntArray) -> FloatArray:
    """(N,) thrust as autopilots state it, 0 to 1: half at hover, and half where there are no rotors."""
    state = recording.state
    thrust = state.values.get("thrust", np.ones(len(state)))
    start = int(state.time_ns[0])
    at = (time_ns - start).astype(np.float64)
    grid = (state.time_ns - start).astype(np.float64)
    return np.clip(0.5 * np.interp(at, grid, thrust), 0.0, 1.0)


def heard(recording: Recording, time_ns: IntArray) -> BoolArray:
    """(N,) True where a message sent at that vehicle time reached the recorder."""
    reached = np.ones(len(time_ns), dtype=np.bool_)
    for start, end in recording.lost:
        reached &= ~((time_ns >= start) & (time_ns < end))
    return reached


def arrival_utc_ns(
    recording: Recording, time_ns: IntArray, *, latency_ns: int = 6 * MS_NS, jitter_ns: int = 4 * MS_NS
) -> IntArray:
    """(N,) UTC at which messages sent at rising vehicle times arrive; order is kept, as on a serial link."""
    rng = np.random.default_rng([recording.seed, 0x11A7])
    delay = latency_ns + rng.exponential(jitter_ns, len(time_ns)).astype(np.int64)
    return np.asarray(np.maximum.accumulate(recording.boot_utc_ns + time_ns + delay), dtype=np.int64)
