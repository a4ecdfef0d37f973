"""What a link lost of one sender, by the numbers, times and content of its frames.

The number has eight bits. A frame that does not carry the next one was preceded by a loss, was overtaken,
came twice, belongs to a second counter of the same sender (two radios, two vehicles of one number), or was
sent after a restart. What follows decides, so that a loss stands until something else explains the jump.
A pause after which the number goes on is no loss. A silence after which it does not may hide multiples of
256: as many are added as the sender's own rate makes likely.
"""

from __future__ import annotations

from dataclasses import dataclass, field, fields

import numpy as np

from flysid.facts.repeats import LATELY, NO_CLOCK, ROUND, BoolArray, CopyFinder, FrameRows, IntArray

LATE_WITHIN = ROUND // 4  # places that a frame may be overtaken by
SILENCE_US = 100_000  # a shorter gap hides no round of numbers: that takes 2,560 frames a second
STEP_MS = 5_000  # of a vehicle's clock against the arrivals: less is jitter of the link
AWAKE_US = 2_000_000  # within so long, a vehicle that was started anew states its time
STRANGE_FRAMES = 8 * ROUND  # of others, after which a second counter is forgotten
COUNTERS = 8  # of one sender that are followed
NEAR = 8  # frames ago, a counter may have sent the frame that a late one follows
CONVINCING = 3  # frames in order that return to a counter: it goes on
RARE = 200  # frames to a pause, from which on pauses are no part of a sender's rate


@dataclass(frozen=True)
class LinkLoss:
    """What came of one sender, and what did not.

    `frames`: that came, each counted once.
    `lost`: missing by the sequence alone.
    `hidden`: missing in addition, in multiples of 256, likely.
    `late`: overtaken on their way.
    `repeated`: frames that came again, byte for byte: a router's loop, two ways to one place.
    `silences`, `silent_us`: gaps with losses that lasted `SILENCE_US` or more, and how long they lasted.
    `boots`, `clock_steps`: restarts and jumps of the clock that the frames state.

    >>> LinkLoss(frames=90, lost=10).share
    0.1
    """

    frames: int = 0
    lost: int = 0
    hidden: int = 0
    late: int = 0
    repeated: int = 0
    silences: int = 0
    silent_us: int = 0
    boots: int = 0
    clock_steps: int = 0

    @property
    def missing(self) -> int:
        """Frames that were sent and did not come."""
        return self.lost + self.hidden

    @property
    def share(self) -> float:
        """Of the frames that were sent, those that did not come."""
        return self.missing / max(1, self.missing + self.frames)


COUNTED = tuple(each.name for each in fields(LinkLoss))


@dataclass
class _Counter:
    """One counter of a sender: the number that it will give next, and the jump that it began with."""

    following: int
    seen_us: int
    seen_at: int  # frames of the sender so far
    born_us: int
    born_at: int
    parent: _Counter | None = None
    gap: int = 0  # what of the jump still counts as lost
    silence: _Silence | None = None  # before the jump
    hole: int = 0  # the first number of the jump
    width: int = 0  # and how many it had
    returned: int = 0  # frames of the parent that came after it
    instead: int = 0  # frames lost if the parent's return was a jump, too
    is_contested: bool = False  # whether parent and this one go on is seen when this one speaks again
    is_second: bool = False  # beside another that goes on, too
    clock_ms: int = NO_CLOCK  # of the vehicle, as last stated, and when that was
    clock_at_us: int = 0


@dataclass
class _Pace:
    """Times from one number to the next: their sum and count, of all and of those shorter than a silence."""

    whole_us: float = 0.0
    steps: int = 0
    brief_us: float = 0.0
    brief: int = 0

    def take(self, waits_us: IntArray) -> None:
        """Take in some of these times."""
        short = waits_us[waits_us < SILENCE_US]
        self.whole_us += float(waits_us.sum())
        self.steps += len(waits_us)
        self.brief_us += float(short.sum())
        self.brief += len(short)

    @property
    def interval_us(self) -> float:
        """From frame to frame as sent; 0 where nothing is known. Pauses count where they are a habit."""
        if self.brief and (self.steps - self.brief) * RARE < self.steps:
            return self.brief_us / self.brief
        return self.whole_us / self.steps if self.steps else 0.0


@dataclass
class _Silence:
    """A silence that ended with a jump: how many rounds it hides is seen by the pace before and after it."""

    gap: int
    waited_us: int
    before_us: float
    after: _Pace = field(default_factory=_Pace)

    @property
    def hidden(self) -> int:
        """Frames in whole rounds, at the slower of the two paces; 0 where no number of rounds fits."""
        interval_us = max(self.before_us, self.after.interval_us)
        expected = self.waited_us / interval_us - 1.0
        rounds = max(0, round((expected - self.gap) / ROUND))
        unexplained = abs(expected - self.gap - ROUND * rounds)
        return ROUND * rounds if unexplained <= max(LATE_WITHIN / 4, expected / 8) else 0


@dataclass
class SequenceCounter:
    """Counts the losses of one sender, batch by batch.

    >>> frames = FrameRows(np.array([0, 1, 4]), None, np.array([7, 8, 9]), np.full(3, NO_CLOCK))
    >>> counter = SequenceCounter()
    >>> _ = counter.count(frames)
    >>> counter.loss.lost
    2
    """

    _counts: dict[str, int] = field(default_factory=lambda: dict.fromkeys(COUNTED, 0))
    _copies: CopyFinder = field(default_factory=CopyFinder)
    _counters: list[_Counter] = field(default_factory=list)  # the latest one at the end
    _pace: _Pace = field(default_factory=_Pace)  # since a while
    _older: _Pace = field(default_factory=_Pace)  # the while before
    _pause_us: int = 0
    _silences: list[_Silence] = field(default_factory=list)

    def count(self, rows: FrameRows) -> tuple[BoolArray, BoolArray]:
        """Take in frames; returns which are no repeats, and which a vehicle sent first after a restart.

        `rows`: (n,) frames, in the order of their arrival.
        """
        copies, doubted, taken_back = self._copies.find(rows, self._counts["frames"], self._known_pace_us)
        self._add(frames=-taken_back, repeated=taken_back)
        restarts = np.zeros(len(copies), dtype=bool)
        sure = np.flatnonzero(~copies & ~doubted)
        for at in np.flatnonzero(
            doubted
        ).tolist():  # two radios, or two boots, may send the same as one number
            before, sure = sure[sure < at], sure[sure > at]
            restarts[before] = self._follow(rows.where(before))
            if self._is_next(int(rows.sequence[at])):
                self._follow(rows.where(np.array([at])))
            else:
                self._add(frames=1)
        restarts[sure] = self._follow(rows.where(sure))
        self._add(repeated=int(copies.sum()))
        return ~copies, restarts

    def shift(self, step_us: int) -> None:
        """The host's clock was set: what was seen before is dated anew."""
        self._copies.shift(step_us)
        for counter in self._counters:
            counter.seen_us += step_us
            counter.born_us += step_us
            counter.clock_at_us += step_us

    @property
    def loss(self) -> LinkLoss:
        """What has been counted so far."""
        hidden = self._counts["hidden"] + sum(silence.hidden for silence in self._silences)
        return LinkLoss(**{**self._counts, "hidden": hidden})

    def _add(self, **counts: int) -> None:
        for name, count in counts.items():
            self._counts[name] += count

    # ------------------------------------------------------------------------------------------- losses

    def _follow(self, rows: FrameRows) -> BoolArray:
        """Take in fresh frames run by run, a run being of numbers in a row; returns the restarts."""
        if not len(rows):
            return np.zeros(0, dtype=bool)
        numbers = rows.sequence
        stamps = rows.stamp_us if rows.stamp_us is not None else np.zeros(len(rows), np.int64)
        begins = np.flatnonzero(np.diff(numbers, prepend=numbers[:1]) % ROUND != 1)
        ends = np.append(begins[1:], len(rows))
        dated = np.flatnonzero(rows.clock_ms != NO_CLOCK)
        clocks = list(zip(dated.tolist(), rows.clock_ms[dated].tolist(), stamps[dated].tolist(), strict=True))
        edges = np.searchsorted(dated, ends).tolist()
        restarts = np.zeros(len(rows), dtype=bool)
        first = 0
        for begin, end, edge in zip(begins.tolist(), ends.tolist(), edges, strict=True):
            self._add(frames=end - begin)
            timed = rows.stamp_us is not None
            counter = self._run(int(numbers[begin]), stamps[begin:end], timed)
            for at, clock_ms, stamp_us in clocks[first:edge]:
                restarts[at] = self._reads_clock(counter, clock_ms, stamp_us, timed)
            first = edge
        return restarts

    def _run(self, number: int, stamps: IntArray, timed: bool) -> _Counter:
        """One run of frames, from `number` on; returns the counter that they are of."""
        size = len(stamps)
        first_us, last_us = int(stamps[0]), int(stamps[-1])
        counter = self._continued(number, size)
        goes_on = counter is not None and counter is self._counters[-1]
        late_for = None if counter else self._hole_of(number, size, first_us)
        if late_for is not None:
            self._fill(late_for, size)
            return late_for
        if counter is None:
            counter = self._begun(number, size, first_us, timed)
        if timed and goes_on:
            self._take_pace(np.array([first_us - counter.seen_us]))
        if timed and size > 1:
            self._take_pace(np.diff(stamps))
        counter.following = (number + size) % ROUND
        counter.seen_us = last_us
        counter.seen_at = self._counts["frames"]
        others = [c for c in self._counters if c is not counter]
        self._counters = [*others[1 - COUNTERS :], counter]
        return counter

    def _reads_clock(self, counter: _Counter, clock_ms: int, stamp_us: int, timed: bool) -> bool:
        """Whether a vehicle's clock began anew before it stated this time."""
        before = counter
        if before.clock_ms == NO_CLOCK and before.parent is not None:
            before = before.parent
        known = before.clock_ms != NO_CLOCK
        passed_ms = clock_ms - before.clock_ms
        waited_ms = (stamp_us - before.clock_at_us) // 1000 if timed else max(0, passed_ms)
        counter.clock_ms, counter.clock_at_us = clock_ms, stamp_us
        if not known or abs(passed_ms - waited_ms) <= STEP_MS:
            return False
        if passed_ms >= 0:
            self._add(clock_steps=1)
            return False
        if not before.is_second or before is counter:
            self._add(boots=1)
            self._excuse(counter, stamp_us, timed)
            return True
        return False

    def _continued(self, number: int, size: int) -> _Counter | None:
        """The counter whose next number this is: the latest one, else another that may go on."""
        for counter in reversed(self._counters):
            if counter.following != number:
                continue
            silent = self._silent(counter, size)
            far = counter.is_second or counter.is_contested
            if counter is self._counters[-1] or silent <= (STRANGE_FRAMES if far else LATE_WITHIN):
                self._returned(counter, number, size)
                return counter
        return None

    def _is_next(self, number: int) -> bool:
        """Whether a counter that sent a moment ago, or one that goes on beside it, is at this number."""
        at_it = (c for c in self._counters if c.following == number)
        return any(c.is_second or self._silent(c, 0) <= NEAR for c in at_it)

    def _silent(self, counter: _Counter, size: int) -> int:
        """Frames of the sender between a counter's last and a run of this size that has been counted."""
        return self._counts["frames"] - size - counter.seen_at

    def _returned(self, counter: _Counter, number: int, size: int) -> None:
        """A counter goes on, perhaps although another was taken for its continuation."""
        if counter.is_contested and counter.parent is not None:  # both go on
            self._forgive(counter)
            counter.is_contested = False
            counter.is_second = counter.parent.is_second = True
        for child in self._counters:
            if child.parent is not counter or child.is_second:
                continue
            if size <= LATE_WITHIN:
                self._fill(child, size)
            elif not child.is_contested:  # or the numbers jumped, by chance to the one that is due here
                child.instead = (number - child.following) % ROUND
                self._add(lost=child.instead)
            late_at_most = min(child.width, LATE_WITHIN)
            child.is_contested |= size > LATE_WITHIN or child.returned > late_at_most

    def _hole_of(self, number: int, size: int, first_us: int) -> _Counter | None:
        """The counter whose jump left these frames out, where they were overtaken on their way."""
        for child in reversed(self._counters):
            inside = (number - child.hole) % ROUND < child.width
            if inside and child.gap and self._counts["frames"] - size - child.born_at < LATE_WITHIN:
                ahead = (number - self._counters[-1].following) % ROUND
                if not self._is_due(ahead, first_us - self._counters[-1].seen_us):
                    return child
        return None

    def _fill(self, child: _Counter, size: int) -> None:
        """Frames came after all that the jump of a counter left out."""
        filled = min(size, child.gap)
        child.gap -= filled
        child.returned += size
        self._add(lost=-filled, late=filled)

    def _forgive(self, counter: _Counter) -> None:
        """A jump was no loss."""
        self._add(lost=-counter.gap - counter.instead)
        counter.gap = counter.instead = 0
        self._silences = [silence for silence in self._silences if silence is not counter.silence]

    def _excuse(self, counter: _Counter, restart_us: int, timed: bool) -> None:
        """A vehicle was started anew: its numbers began anew a moment ago, and nothing was lost."""
        awake = restart_us - counter.born_us < AWAKE_US
        if awake if timed else self._counts["frames"] - counter.born_at < ROUND:
            self._forgive(counter)

    def _begun(self, number: int, size: int, first_us: int, timed: bool) -> _Counter:
        """A jump: the counter that begins with it, and what is taken for lost until it is explained."""
        born_at = self._counts["frames"] - size
        fresh = _Counter(number, first_us, born_at, first_us, born_at)
        if not self._counters:
            return fresh
        may = [c for c in self._counters if self._silent(c, size) <= self._reach(c)]
        parent = min(may or self._counters[-1:], key=lambda c: (number - c.following) % ROUND)
        gap = (number - parent.following) % ROUND
        waited_us = first_us - parent.seen_us
        fresh.parent, fresh.hole, fresh.is_second = parent, parent.following, parent.is_second
        if gap >= ROUND - LATE_WITHIN and not self._is_due(gap, waited_us):
            self._add(late=int(size == 1))
            return fresh
        fresh.gap = fresh.width = gap
        self._add(lost=gap)
        if timed and waited_us >= SILENCE_US:
            self._add(silences=1, silent_us=waited_us)
            fresh.silence = self._fallen_silent(gap, waited_us)
        if self._is_beside(parent):  # the other goes on, and this takes the place of its parent
            self._counters = [c for c in self._counters if c is not parent]
            for child in self._counters:
                child.parent = fresh if child.parent is parent else child.parent
        return fresh

    def _reach(self, counter: _Counter) -> int:
        """Frames of others after which a counter may still have lost the next ones."""
        return STRANGE_FRAMES if self._is_beside(counter) else NEAR

    def _is_beside(self, counter: _Counter) -> bool:
        """Whether a counter is known, or about to be known, to go on beside another."""
        children = (child for child in self._counters if child.parent is counter)
        return counter.is_second or any(child.returned >= CONVINCING for child in children)

    # -------------------------------------------------------------------------------------------- rates

    def _take_pace(self, waits_us: IntArray) -> None:
        """Take in times from one number to the next."""
        self._pause_us = max(self._pause_us, int(waits_us.max()))
        self._pace.take(waits_us)
        if self._pace.steps > STRANGE_FRAMES:
            self._older, self._pace = self._pace, _Pace()
        for silence in self._silences[-COUNTERS:]:
            if silence.after.steps < ROUND:
                silence.after.take(waits_us)

    @property
    def _interval_us(self) -> float:
        """From frame to frame, lately."""
        pace = self._pace if self._pace.steps >= ROUND or not self._older.steps else self._older
        return pace.interval_us

    @property
    def _known_pace_us(self) -> float:
        """From frame to frame, once enough of them were timed; 0 before."""
        return self._interval_us if self._older.steps or self._pace.steps >= LATELY else 0.0

    def _is_due(self, gap: int, waited_us: int) -> bool:
        """Whether so many frames can have been sent meanwhile, give or take a half."""
        interval_us = self._interval_us
        return interval_us > 0.0 and 2 * waited_us > gap * interval_us

    def _fallen_silent(self, gap: int, waited_us: int) -> _Silence | None:
        """A silence that may hide rounds: longer than any pause after which the numbers went on."""
        if self._interval_us <= 0.0 or waited_us <= self._pause_us:
            return None
        silence = _Silence(gap, waited_us, self._interval_us)
        self._silences.append(silence)
        if len(self._silences) > COUNTERS:  # the oldest is past doubt, and recordings last for days
            self._add(hidden=self._silences.pop(0).hidden)
        return silence
