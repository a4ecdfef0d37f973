"""flysid record: write what comes over links, whole and counted."""

from __future__ import annotations

import signal
import threading
import time
from contextlib import suppress
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Any

import click

from flysid.cli.bounds import AT_LEAST_ONE, POSITIVE
from flysid.cli.output import ExitCode, say
from flysid.cli.trust import Own, Setting
from flysid.errors import UsageError
from flysid.facts.link import LinkLoss
from flysid.facts.losses import link_words
from flysid.showing import counted

if TYPE_CHECKING:
    from flysid.live.recording import Recording


@click.command("record")
@click.argument("links", nargs=-1, required=True, metavar="LINK...")
@click.option(
    "-o", "--output", required=True, type=click.Path(path_type=Path), help="The file, e.g. flight.tlog."
)
@click.option(
    "--rotate",
    cls=Setting,
    multiple=True,
    metavar="WHEN",
    help="Start a new part: 256MB, 10min or boot; repeatable.",
)
@click.option("--key", type=click.Path(path_type=Path), help="File of the signing key, mode 0600.")
@click.option(
    "--unsigned",
    cls=Own,
    type=click.Choice(["reject", "keep", "radio"]),
    default="reject",
    show_default=True,
    help="With a key: frames without a signature; radio keeps only RADIO_STATUS.",
)
@click.option("--heartbeat", cls=Own, is_flag=True, help="Send heartbeats; otherwise nothing is sent.")
@click.option(
    "--buffer",
    cls=Own,
    type=AT_LEAST_ONE,
    metavar="BYTES",
    help="Socket buffer.  [default: as large as possible]",
)
@click.option("--for", "seconds", type=POSITIVE, metavar="S", help="Stop after this many seconds.")
@click.option("-q", "--quiet", is_flag=True, help="Only paths and errors.")
def command(
    links: tuple[str, ...],
    output: Path,
    rotate: tuple[str, ...],
    key: Path | None,
    unsigned: str,
    heartbeat: bool,
    buffer: int | None,
    seconds: float | None,
    quiet: bool,
) -> int:
    """Record LINKs into a tlog until interrupted; print the paths of the parts.

    A LINK is udp:HOST:PORT (listens there), udpout:HOST:PORT, tcp:HOST:PORT or serial:DEVICE:BAUD.
    FILE.json counts, per link and system, the frames received, those lost on the link and those dropped by
    this host. FILE.rejects keeps the first bytes that belong to no frame. The key may also be given in
    FLYSID_SIGNING_KEY. Exit code 5: disk error; 3: this host dropped data.
    """
    from flysid.live.receiving import warm_up
    from flysid.live.recording import Recording
    from flysid.live.recording_parts import parse_rotation
    from flysid.live.signing import Guard, load_key

    rotation = parse_rotation(rotate)
    secret = load_key(key)
    guard = None if secret is None else Guard(secret, unsigned)
    warm_up()
    recording = Recording(open_links(links, buffer, heartbeat), output, rotation, guard, heartbeat)
    for text in recording.receiver.warnings():
        say(text, quiet)
    run(recording, seconds, quiet)
    for path in recording.parts.paths:
        click.echo(path)
    return finish(recording, quiet)


def open_links(links: tuple[str, ...], buffer: int | None, sends: bool) -> list[Any]:
    """The links, all open; none where one cannot be."""
    from flysid.live.links import open_link

    made: list[Any] = []
    try:
        made.extend(open_link(text, buffer=buffer, sends=sends) for text in links)
    except UsageError:
        for link in made:
            link.close()
        raise
    return made


def run(recording: Recording, seconds: float | None, quiet: bool) -> None:
    """Record until a signal comes, or the time is over; one line of state now and then."""
    over = threading.Event()

    def end(_: int, __: FrameType | None) -> None:
        over.set()

    with suppress(ValueError):  # signals are the main thread's
        signal.signal(signal.SIGINT, end)
        signal.signal(signal.SIGTERM, end)
    recording.start()
    until = None if seconds is None else time.monotonic() + seconds
    refusal = ""
    warned = set(recording.receiver.warnings())
    try:
        while recording.is_alive and not over.wait(0.2):
            if until is not None and time.monotonic() >= until:
                break
            if recording.parts.refusal and not refusal:
                refusal = recording.parts.refusal
                say(f"{refusal}: writing has stopped; receiving continues")
            for text in recording.receiver.warnings():
                if text not in warned:
                    warned.add(text)
                    say(text, quiet)
    finally:
        recording.stop()


def finish(recording: Recording, quiet: bool) -> int:
    """The words that end a recording, and the exit code."""
    parts = recording.parts
    facts = recording.last_facts
    say(f"{counted(parts.frames, 'frame')}, {counted(parts.bytes, 'byte')}", quiet)
    dropped = recording.spool.dropped_frames
    for link in facts["links"]:
        dropped += link["dropped_by_host"] or 0
        for peer in link["peers"]:
            for text in peer_lines(peer):
                say(f"{link['link']}, {peer['peer']}: {text}", quiet)
    if dropped:
        say(f"this host dropped {counted(dropped, 'datagram')}: see {parts.paths[-1]}.json")
    if parts.refusal:
        say(f"{parts.refusal}: {counted(parts.unwritten_frames, 'frame')} received, not written")
        return ExitCode.DISK_REFUSED
    return ExitCode.LOSSES if dropped else 0


def peer_lines(peer: dict[str, Any]) -> list[str]:
    """What a peer sent, a line for each system; then what was no frame and what was refused."""
    lines = []
    for row in peer["systems"]:
        loss = LinkLoss(
            frames=row["frames"] - row["repeated"],
            lost=row["lost_by_sequence"],
            hidden=row["lost_in_silence_about"],
            repeated=row["repeated"],
        )
        sender = f"system {row['system']}, component {row['component']}"
        lines.append(f"{sender}: {counted(row['frames'], 'frame')}, {link_words(loss)}")
    if peer["bytes_that_are_no_frame"]:
        lines.append(f"{counted(peer['bytes_that_are_no_frame'], 'byte')} of no frame")
    lines += [f"refused, {reason}: {counted(n, 'frame')}" for reason, n in peer["refused"].items()]
    return lines
