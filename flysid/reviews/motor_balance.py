"""How evenly the motors work: trims in roll, pitch and yaw, and the one motor that stands out.

The means of four commands are hover and three trims, exactly: what a motor is commanded cannot tell a weak
motor from a heavy corner. Only its speed can.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from flysid.dataset import FloatArray
from flysid.ingest.lake.motors import Motor
from flysid.reviews.fact import Action, Fact, Finding, Grade, MotorPlan
from flysid.reviews.figures import absent, fact_of, limit
from flysid.reviews.hover import find_calm
from flysid.reviews.logged import LoggedFlight
from flysid.showing import list_words

AXES = ("roll", "pitch", "yaw")
LEAST_S = 5.0
"""In the air: trims of less are those of one gust."""


@dataclass(frozen=True, eq=False)
class Balance:
    """Means in flight.

    `shares`: (n,) of the motors' ranges.
    `trims`: roll, pitch and yaw, as shares of the mean.
    `doubts`: half the interval of 95 % of each trim, from how much blocks of the flight differ.
    `speeds`: (n,) rpm; NaN where it is not logged.
    `calm`: only level and slow flight was taken.
    """

    motors: tuple[Motor, ...]
    shares: FloatArray
    trims: dict[str, float]
    doubts: dict[str, float]
    speeds: FloatArray
    calm: bool

    @property
    def spread(self) -> float:
        """From the least to the most, as a share of the mean."""
        return float(np.ptp(self.shares) / self.shares.mean())

    @property
    def grade(self) -> Grade:
        """Of the spread; good, too, where the largest trim may be a slow wave."""
        axis = main_axis(self)
        if self.doubts[axis] > abs(self.trims[axis]):
            return Grade.GOOD
        return limit("power.motor_spread").grade(100.0 * self.spread)

    @property
    def odd(self) -> int | None:
        """The one motor that differs while the others are alike; None where none does."""
        away = [abs(self.apart(i)) for i in range(len(self.shares))]
        i = int(np.argmax(away))
        others = np.delete(self.shares, i)
        return i if np.ptp(others) < 0.4 * away[i] * others.mean() else None

    def apart(self, i: int) -> float:
        """How much more a motor is driven than the mean of the others, as a share."""
        return float(self.shares[i] / np.delete(self.shares, i).mean() - 1.0)

    def faster(self, i: int) -> float:
        """How much faster a motor turns than the mean of the others, as a share; NaN for unknown."""
        return float(self.speeds[i] / np.delete(self.speeds, i).mean() - 1.0)


def weigh(flight: LoggedFlight, motors: tuple[Motor, ...]) -> Balance | None:
    """Means over level and slow flight, else over all of the flight; None where it was too short."""
    if len(motors) < 3:
        return None
    time_s = motors[0].command.time_s
    period_s = motors[0].command.period_s
    calm = find_calm(flight, time_s)
    enough = calm.sum() * period_s >= LEAST_S
    chosen = calm if enough else flight.flying(time_s)
    if not chosen.sum() * period_s >= LEAST_S:  # nor where a lone sample has no period
        return None
    shares = np.array([np.nanmean(m.command.at(time_s[chosen])) for m in motors])
    if not shares.mean() > 0.0:
        return None
    speeds = np.array([_mean_speed(m, time_s[chosen]) for m in motors])
    trims = _trims(motors, shares)
    return Balance(motors, shares, trims, _doubts(motors, time_s[chosen]), speeds, enough)


def _mean_speed(motor: Motor, time_s: FloatArray) -> float:
    if motor.speed is None:
        return float("nan")
    speeds = motor.speed.at(time_s)
    return float(np.nanmean(speeds)) if np.isfinite(speeds).any() else float("nan")


def _doubts(motors: Sequence[Motor], time_s: FloatArray, *, block_s: float = 5.0) -> dict[str, float]:
    """Axis -> half the interval of its trim; a slow wave in a short flight is no trim."""
    blocks = (time_s // block_s).astype(int)
    found = []
    for block in np.unique(blocks):
        shares = np.array([np.nanmean(m.command.at(time_s[blocks == block])) for m in motors])
        if shares.mean() > 0.0:
            found.append(list(_trims(motors, shares).values()))
    if len(found) < 3:
        return dict.fromkeys(AXES, float("inf"))
    half = 1.96 * np.std(found, axis=0, ddof=1) / np.sqrt(len(found))
    return dict(zip(AXES, half.tolist(), strict=True))


def _trims(motors: Sequence[Motor], shares: FloatArray) -> dict[str, float]:
    """By least squares on what each motor does to roll, pitch and yaw."""
    forward, right = np.array([m.place for m in motors]).T
    effects = [np.sign(-right), np.sign(forward), np.array([m.spin for m in motors])]
    found = {}
    for axis, effect in zip(AXES, effects, strict=True):
        acting = np.where(np.abs(effect) > 0.0, effect, 0.0)
        found[axis] = float(acting @ shares / np.abs(acting).sum() / shares.mean())
    return found


def facts(balance: Balance | None, motors: tuple[Motor, ...], remedy: str) -> Iterator[Fact]:
    """Spread, trims, each motor's mean and speed."""
    if balance is None:
        unknown = "no motor commands are logged, or the frame is not known"
        yield absent("power.motor_spread", "the flight is too short" if motors else unknown, remedy)
        return
    fields = tuple(m.command.address for m in balance.motors)
    note = "level and slow flight" if balance.calm else "the whole flight: its trims hold its manoeuvres, too"
    yield fact_of("power.motor_spread", 100.0 * balance.spread, fields, note=note, grade=balance.grade)
    for axis, trim in balance.trims.items():
        share, half = 100.0 * trim, 100.0 * balance.doubts[axis]
        interval = (share - half, share + half) if np.isfinite(half) else None
        note = "of the hover thrust"
        yield fact_of("power.trim_{axis}", share, fields, interval=interval, note=note, axis=axis)
    for motor, share, speed in zip(balance.motors, balance.shares, balance.speeds, strict=True):
        number = motor.number
        yield fact_of("power.motor_{number}", 100.0 * float(share), (motor.command.address,), number=number)
        if motor.speed is not None and np.isfinite(speed):
            yield fact_of("power.motor_{number}_rpm", float(speed), (motor.speed.address,), number=number)


def findings(balance: Balance | None) -> Iterator[Finding]:
    """The motor that stands out, or the axis that is trimmed."""
    if balance is None:
        return
    grade, key = balance.grade, "power.motor_spread"
    if grade is Grade.GOOD:
        if limit(key).grade(100.0 * balance.spread) is Grade.GOOD:  # else it differs, but not for good
            worst = f"{max(1.0, 100.0 * balance.spread):.0f} %"
            yield Finding(f"The motors share the load evenly, within {worst}", grade, 0.3, key)
    elif balance.odd is not None:
        yield Finding(_odd_words(balance, balance.odd), grade, 0.85, key, _odd_more(balance, balance.odd))
    else:
        axis = main_axis(balance)
        more = f"{axis} trim of {abs(100.0 * balance.trims[axis]):.0f} %: {CAUSES[axis]}"
        yield Finding(f"Motors {_pair_words(balance)}", grade, 0.66, key, more)


CAUSES = {
    "roll": "the load sits to one side, or motors of one side give less",
    "pitch": "the load sits forward or aft, or motors of one end give less",
    "yaw": "motors or arms are twisted, or motors of one direction give less",
}


def main_axis(balance: Balance) -> str:
    """The axis with the largest trim."""
    return max(AXES, key=lambda axis: abs(balance.trims[axis]))


def pair_of(balance: Balance) -> tuple[list[int], list[int], float]:
    """Numbers of the motors that carry more and less along the main axis, and how much more as a share."""
    axis = main_axis(balance)
    effects = {"roll": lambda m: -m.place[1], "pitch": lambda m: m.place[0], "yaw": lambda m: m.spin}
    signs = np.array([float(np.sign(round(effects[axis](m), 6))) for m in balance.motors])
    signs *= np.sign(balance.trims[axis])
    more, less = balance.shares[signs > 0.0].mean(), balance.shares[signs < 0.0].mean()
    numbers = np.array([m.number for m in balance.motors])
    return numbers[signs > 0.0].tolist(), numbers[signs < 0.0].tolist(), float(more / less - 1.0)


def _odd_words(balance: Balance, i: int) -> str:
    apart = balance.apart(i)
    harder = "harder" if apart > 0.0 else "less"
    text = f"Motor {balance.motors[i].number} is driven {abs(100.0 * apart):.0f} % {harder} than the others"
    faster = balance.faster(i)
    if not np.isfinite(faster):
        return text
    if _turns_alike(balance, i):
        return f"{text} to turn as fast"
    return f"{text} and turns {abs(100.0 * faster):.0f} % {'faster' if faster > 0.0 else 'slower'}"


def _odd_more(balance: Balance, i: int) -> str:
    if not np.isfinite(balance.faster(i)):
        return "commands alone do not tell a weak motor from a heavy corner: ESC speeds would"
    if _turns_alike(balance, i):
        return "its motor, bearing or ESC" if balance.apart(i) > 0.0 else "the other motors, bearings or ESCs"
    return "its propeller, or the load above it"


def _turns_alike(balance: Balance, i: int) -> bool:
    """Whether a motor's speed explains little of its command: thrust grows with the square of the speed."""
    return abs(2.0 * balance.faster(i)) < 0.5 * abs(balance.apart(i))


def actions(balance: Balance | None) -> Iterator[Action]:
    """What to look at on the bench."""
    if balance is None or balance.grade is Grade.GOOD:
        return
    if balance.odd is None:
        axis = main_axis(balance)
        mounts = "Check the mounts of all motors: upright, none twisted"
        yield Action(
            mounts if axis == "yaw" else "Move the battery to the middle",
            f"motors {_pair_words(balance)}: a {axis} trim",
            predicted="motors that share the load evenly",
            weight=0.5,
            fact=f"power.trim_{axis}",
        )
    elif balance.apart(balance.odd) >= 0.0:  # less is no fault of its own, and the log does not show whose
        part = "motor and ESC" if _turns_alike(balance, balance.odd) else "propeller, shaft and mount"
        yield Action(
            f"Check motor {balance.motors[balance.odd].number}: {part}",
            _odd_words(balance, balance.odd),
            predicted=f"motors within {limit('power.motor_spread').watch:.0f} % of each other",
            weight=0.7,
            fact="power.motor_spread",
        )


def _pair_words(balance: Balance) -> str:
    """ "1 and 2 carry 28 % more than 3 and 4"."""
    high, low, share = pair_of(balance)
    more, less = (list_words([str(n) for n in numbers]) for numbers in (high, low))
    return f"{more} carry {100.0 * share:.0f} % more than {less}"


def plan(balance: Balance | None) -> Iterator[MotorPlan]:
    """Motors from above."""
    if balance is not None:
        names = tuple(str(m.number) for m in balance.motors)
        places = tuple(m.place for m in balance.motors)
        shares = tuple(float(share) for share in balance.shares)
        yield MotorPlan("Motors", places, shares, names, "% of full, mean in flight")
