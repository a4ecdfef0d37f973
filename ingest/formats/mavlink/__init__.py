"""MAVLink telemetry: `.tlog` and raw streams."""
