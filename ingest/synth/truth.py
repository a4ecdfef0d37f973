"""The truth of a flight as parquet, to hold logs and models against.

Columns: time_ns (vehicle clock), the commands in force, then every quantity of the flight without sensor
errors, in the paper's signs, with units in the field metadata.
"""

from __future__ import annotations

import io

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from flysid.flight import TIME, field_metadata
from flysid.ingest.synth.telemetry import Recording

UNITS = {
    "theta_in": "deg",
    "phi_in": "deg",
    "vz_in": "m/s",
    "p": "deg/s",
    "q": "deg/s",
    "r": "deg/s",
}
UNITS |= dict.fromkeys(("thrust", "throttle", "roll_effort", "pitch_effort", "yaw_effort"), "")
UNITS |= dict.fromkeys(("vx", "vy", "vz"), "m/s") | dict.fromkeys("xyz", "m")
UNITS |= dict.fromkeys(("phi", "theta", "psi"), "deg")


def truth_table(recording: Recording) -> pa.Table:
    """The truth as an Arrow table."""
    truth = recording.truth
    command = recording.command
    held = np.maximum(np.searchsorted(command.time_ns, truth.time_ns, side="right") - 1, 0)
    columns = {name: values[held] for name, values in command.values.items()} | dict(truth.values)
    fields = [pa.field(TIME, pa.int64(), metadata=field_metadata(unit="ns"))]
    fields += [pa.field(name, pa.float64(), metadata=field_metadata(unit=UNITS[name])) for name in columns]
    arrays = [pa.Array.from_buffers(pa.int64(), len(truth), [None, pa.py_buffer(truth.time_ns.tobytes())])]
    arrays += [
        pa.Array.from_buffers(pa.float64(), len(v), [None, pa.py_buffer(np.ascontiguousarray(v).tobytes())])
        for v in columns.values()
    ]
    return pa.Table.from_arrays(arrays, schema=pa.schema(fields))


def truth_bytes(recording: Recording) -> bytes:
    """The truth as a parquet file."""
    file = io.BytesIO()
    pq.write_table(truth_table(recording), file, compression="zstd")
    return file.getvalue()
