"""AR.Drone navdata: packets, pcap, AT commands."""

from flysid.ingest.formats.base import Format

FORMATS = (
    Format(
        "navdata",
        "AR.Drone navdata (packets or pcap)",
        (".navdata", ".pcap", ".pcapng", ".cap"),
        "flysid.ingest.formats.ardrone.reader",
        "flysid.ingest.formats.ardrone.scrub",
    ),
)
