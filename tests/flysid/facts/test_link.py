"""What a link lost is counted as it was: by reading and by recording, whatever else befell the frames."""

from __future__ import annotations

import json
import random
from pathlib import Path

import numpy as np
import pytest

from flysid.facts.link import SequenceCounter
from flysid.facts.losses import link_words
from flysid.facts.repeats import NO_CLOCK, FrameRows
from tests.command import call
from tests.loss_trials import Sender, draw, faults, trials


def rows(numbers: list[int], stamps_us: list[int], contents: list[int] | None = None) -> FrameRows:
    count = len(numbers)
    sums = np.arange(count) if contents is None else np.array(contents)
    return FrameRows(np.array(numbers), np.array(stamps_us), sums % 65536, np.full(count, NO_CLOCK))


def counted(frames: FrameRows) -> SequenceCounter:
    counter = SequenceCounter()
    counter.count(frames)
    return counter


def test_random_telemetry_is_counted_as_it_was(fresh_seed: int) -> None:
    outcome = trials(60, lambda: True, fresh_seed)
    assert not outcome.failures


def test_wraps_and_bursts_are_no_losses() -> None:
    """4,101 frames in bursts of 40, a second apart: 102 wraps of the number seemed to be lost."""
    stamps = [1_000_000 * (k // 40) + 300 * (k % 40) for k in range(4101)]
    loss = counted(rows([k % 256 for k in range(4101)], stamps)).loss
    assert (loss.frames, loss.missing, loss.silences) == (4101, 0, 0)
    assert link_words(loss) == "lost by the link: none"


def test_a_pause_is_no_loss() -> None:
    """A pause of 0.85 s at 300 Hz hides just 256 numbers, and 46 % seemed to be lost."""
    stamps = [3333 * k + (850_000 if k >= 300 else 0) for k in range(600)]
    assert counted(rows([k % 256 for k in range(600)], stamps)).loss.missing == 0


def test_who_does_not_count_repeats_itself_freely() -> None:
    """A script that numbers every frame 0 sends its heartbeat again and again: none of them is a copy."""
    loss = counted(rows([0] * 100, [10_000 * k for k in range(100)], [7] * 100)).loss
    assert loss.repeated == 0


@pytest.mark.parametrize("lag_us", [0, 30_000])
def test_a_loop_of_routers_is_named_by_every_verb(tmp_path: Path, lag_us: int) -> None:
    """50 attitudes a second that a loop sends twice are 50, not 100; and it is said."""
    sender = Sender(1, 20_000, random.Random(1))
    sent = [sender.send(20_000) for _ in range(1000)]
    twice = sorted(sent + [(at + lag_us, frame) for at, frame in sent], key=lambda f: f[0])
    log = tmp_path / "loop.tlog"
    log.write_bytes(b"".join(at.to_bytes(8, "big") + frame for at, frame in twice))
    found = json.loads(call("doctor", log, "--json", cwd=tmp_path).stdout)["logs"][0]
    assert found["rates_hz"]["attitude"]["1.1/ATTITUDE"] == pytest.approx(
        47.5, abs=0.2
    )  # a twentieth: heartbeats
    assert found["damage"]["repeats"] == {"1.1": 1000}
    words = "1,000 messages of 1.1 came again, byte for byte"
    assert words in " ".join(call("doctor", log, cwd=tmp_path).stdout.split())
    assert words in call("show", log, cwd=tmp_path).stdout
    assert words in call("ingest", log, "-o", tmp_path / "data", cwd=tmp_path).stderr


def test_a_short_first_step_hides_no_copies() -> None:
    """A copy 60 ms late seemed to be new behind two frames 0.2 ms apart."""
    assert not list(faults(draw(340_965_655_587)))


def test_the_second_radio_of_a_vehicle_is_no_loss() -> None:
    trial = draw(next(s for s in range(1000) if list(draw(s).kinds.values()) == ["two radios"]))
    assert not list(faults(trial))
