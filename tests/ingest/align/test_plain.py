"""Motor commands have no unit, whatever the log says of them."""

import numpy as np
import pyarrow as pa
import pytest

from flysid.flight import Flight, Source
from flysid.ingest.align.recipe import load_recipe
from flysid.ingest.align.signals import FlightLog, find_source, load_source
from tests.ingest.align.test_align import table


@pytest.mark.parametrize(("stream", "field"), [("RCOU", "C1"), ("SERVO_OUTPUT_RAW", "servo1_raw")])
def test_pulse_widths_are_motor_commands_in_logs_that_know_their_unit(stream: str, field: str) -> None:
    """Every log of today's ArduPilot was refused: "us cannot become a plain number"."""
    times = np.arange(5, dtype=np.int64) * 10_000_000
    plain = table(times, None, 0, **{field: np.arange(1500.0, 1505.0)})
    told = pa.field(field, pa.float64(), metadata={"unit": "s", "scale": "1e-06"})
    schema = plain.schema.set(plain.schema.get_field_index(field), told)
    log = FlightLog(Flight(Source("f", "tlog", 1, "0" * 64), {stream: plain.cast(schema)}))
    motor = load_recipe("rotorcraft-motors").signals["motor1"]
    found = find_source(motor.sources, log)
    assert found is not None
    x = load_source(*found, motor.unit, log).boots[0].x
    assert np.ptp(x) == pytest.approx(4e-6)
