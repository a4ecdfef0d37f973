"""The rate controller of a blackbox log: what its header states, and what it comes to in small motions.

The laws themselves are data, `flysid/laws`: Betaflight 3.1 to 4.6 (2025.12) and INAV. In thousandths of the
motors' range, with the error e = r - y and the derivative's filters F, first order (PT1 to PT3) or second
(biquad), and a notch,

    P: p e      I: i integral of e      D: d (w r - F y)'      F: f r', shaped, and recorded by the log

In 3.1 the weighed setpoint goes through the filters as well; its weight w is w0 min(|stick| / ratio, 1) where
the header states a ratio between 0 and 1. Above a throttle of `tpa_breakpoint` D, or P and D, shrink (TPA),
with `tpa_low_always` also below `tpa_low_breakpoint`.
The integral slows down while the axes ask for more than a share of the motors' range (windup) and while the
setpoint moves quickly (relax), and runs faster while the throttle moves (anti-gravity). D grows from its
least to its most with quick motions (d_min, d_max). The first low-pass may follow the throttle.

The loop's steps take longer than the header says where the gyro's clock or the processor is slow: filters
are those of the stated step, and in some versions so are integral and derivative; others measure it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from flysid.dataset import FloatArray
from flysid.ingest.lake.headers import needed_numbers, stated_number, stated_numbers
from flysid.laws.described import Law, blackbox_law
from flysid.loops.controller import Controller
from flysid.loops.law_parts import (
    NO_THROTTLE,
    AntiGravity,
    Boost,
    Means,
    Moving,
    Relax,
    TermCheck,
    taper,
    unpack_limit,
)
from flysid.loops.stages import ComplexArray, Filters, filters_of

AXES = {"roll": "rollPID", "pitch": "pitchPID", "yaw": "yawPID"}
FULL_THROTTLE = 2000.0
"""us, where the law has no setting for it."""
IDLE_STICK = 1050.0
"""us of throttle below which the motors idle (`min_check`), which headers do not state."""
ANTI_GRAVITY = 1 << 28
"""Bit of `features` that switches it on."""
ACCELERATION = 100.0
"""deg/s^2 to a unit of the setpoint's limit."""
UNLIMITED = 1000.0
"""Of an output whose limit the header does not state: all of the motors' range."""
RELAXED_YAW = (2, 4)
"""Modes of the relaxed integral that include yaw."""
RELAXED_BY_SETPOINT = 1.0


def stated_step_s(settings: Mapping[str, str]) -> float:
    """Of the rate loop, s, as a header states it; 0 where it does not."""
    return (
        1e-6
        * stated_number(settings, "looptime", otherwise=0.0)
        * stated_number(settings, "pid_process_denom", otherwise=1.0)
    )


@dataclass(frozen=True, eq=False)
class Conditions:
    """What the gains of one flight depended on.

    `throttle`: (N,) us.
    `setpoint`, `stick`: (N,) deg/s, and the stick's way from its middle, 0 to 1.
    `slower`: steps of the loop over those that the header states.
    `means`: of what moves in laws since 4.0; None: of TPA alone, by the throttle.
    `forward`: f (Hz), and the recorded F term's response to the setpoint there; None where there is no F
        term.
    `checks`: how well the law's terms are those that the log recorded.
    `forward_gain`: of the law's F term.
    `output_limit`: of the controller, thousandths.
    """

    throttle: FloatArray
    setpoint: FloatArray
    stick: FloatArray
    slower: float = 1.0
    means: Means | None = None
    forward: tuple[FloatArray, ComplexArray] | None = None
    checks: tuple[TermCheck, ...] = ()
    forward_gain: float = 0.0
    output_limit: float = UNLIMITED


NO_CONDITIONS = Conditions(np.zeros(0), np.zeros(0), np.zeros(0))


@dataclass(frozen=True)
class BetaflightLaw:
    """What a header states of one axis.

    `stated`: gains as the firmware names them.
    `p`, `i`, `d`, `f`: the same in the mixer's numbers; d is the least where D grows.
    `weight`, `relaxed`: of the setpoint in the derivative, and the stick up to which it grows; 0: it does
        not.
    `filters`, `notch`: orders and cut-offs (Hz), and centre and cut-off, of what the derivative goes through.
    `slope_filtered`: the setpoint goes through the filters too: 3.1.
    `stated_steps`: of the derivative, of the integral: whether they count on the stated step.
    `step_s`: stated; 0 where it is not.
    `tpa`, `tpa_terms`: share that it takes at full throttle, and where it begins, us; of which terms.
    `windup`: share of the motors' range beyond which the integral slows down.
    `anti_gravity`: factor of the integral while the throttle moves by more than a threshold (us) in 0.1 s.
    `limits`: of the outputs of roll, pitch and yaw.
    `largest_i`: of the integral.
    `freezes`: the integral does not grow while the axes ask for more than the motors have.
    `rotates`: the integrals of all axes stay where they are in space as the body turns.
    `p_filters`: of yaw's P.
    `boost`, `relax`, `moving`, `faster`: parts that only some versions have.
    `setpoint_field`: of the log.
    `acceleration`: limit of the setpoint, deg/s^2, which sticks do not show; 0: none.
    `cut_terms`: the log has terms without their fractions.
    `title`: version, and which law stands in for an unknown one.
    `not_described`: settings of this log that change the law in a way that is not described.
    `not_stated`: settings that the header lacks, by the term that they move: lost, or never in those of the
        version.
    `full_throttle`: us at which TPA takes its whole share.
    `low_tpa`: share that TPA takes at no throttle, and where it ends, us.
    """

    stated: Mapping[str, float]
    p: float
    i: float
    d: float
    weight: float
    relaxed: float
    filters: Filters
    notch: tuple[float, float]
    slope_filtered: bool
    stated_steps: tuple[bool, bool]
    step_s: float
    tpa: tuple[float, float]
    windup: float
    anti_gravity: tuple[float, float]
    limits: tuple[float, float, float]
    largest_i: float
    freezes: bool = False
    rotates: bool = False
    f: float = 0.0
    tpa_terms: tuple[str, ...] = ("P", "D")
    throttle_of: str = "stick"
    p_filters: Filters = ()
    boost: Boost | None = None
    relax: Relax | None = None
    moving: Moving | None = None
    faster: AntiGravity | None = None
    setpoint_field: str = "setpoint"
    acceleration: float = 0.0
    cut_terms: bool = False
    title: str = ""
    exact: bool = True
    has_forward: bool = False
    not_described: tuple[str, ...] = field(default=())
    not_stated: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    full_throttle: float = FULL_THROTTLE
    low_tpa: tuple[float, float] = (0.0, NO_THROTTLE)

    @classmethod
    def of(cls, settings: Mapping[str, str], axis: str) -> BetaflightLaw:
        """Of an axis, from a header's settings.

        Raises DataError: another firmware, a gain or filter that is missing.
        """
        law = blackbox_law(settings.get("Firmware revision", ""))
        read = _Header(law, settings)
        p, i, d, *more = needed_numbers(settings, AXES[axis], least=3)
        derived = law.part("derivative")
        integral = law.part("integral")
        if axis not in derived["axes"]:
            d = 0.0
        parts = float(derived["weight_parts"])
        weight = read.needed("setpoint_weight")[0] if parts else 0.0
        relaxed = read.needed("relaxed")[0] if parts else 0.0
        forward = more[0] if more else _of_axis(read.several("forward"), axis)
        roll = read.one("limit", UNLIMITED)
        yaw = read.one("yaw_limit", UNLIMITED)
        limits = (roll, roll, yaw)
        least, boost = _boost(law, read, axis, d)
        moving = _moving(law, read)
        limit, windup = float(integral["limit"]), 1.0
        if integral["windup"] == "limit":
            limit = read.one("windup", 100.0) / 100.0 * limits[list(AXES).index(axis)]
        elif integral["windup"] == "share":
            windup = read.one("windup", 100.0) / 100.0
        steps, faster = _anti_gravity(str(integral["anti_gravity"]), read, axis, settings)
        return cls(
            _name_gains(axis, p, i, d, least, forward, bool(law.scale["f"])),
            law.scale["p"] * p,
            law.scale["i"] * i * (law.scale["yaw_i"] if axis == "yaw" else 1.0),
            law.scale["d"] * least,
            weight / parts if parts else 0.0,
            relaxed / 100.0 if relaxed < 100.0 else 0.0,
            _lowpasses(law, read, moving),
            (read.one("notch", 0.0), read.one("notch_cutoff", 0.0)),
            derived["of"] == "both",
            (derived["steps"] == "stated", integral["steps"] == "stated"),
            stated_step_s(settings),
            (read.one("tpa_rate", 0.0) / 100.0, read.one("tpa_breakpoint", FULL_THROTTLE)),
            windup,
            steps,
            limits,
            limit,
            bool(integral.get("freezes", False)),
            bool(integral.get("rotates", False)),
            law.scale["f"] * forward,
            _tpa_terms(law, read, axis),
            str(law.part("throttle")["of"]),
            filters_of("pt1", read.one("yaw_lowpass", 0.0)) if axis == "yaw" else (),
            boost,
            _relax(law, read, axis),
            moving,
            faster,
            str(derived.get("setpoint", "setpoint")),
            ACCELERATION
            * unpack_limit(read.one("yaw_acceleration" if axis == "yaw" else "acceleration", 0.0)),
            bool(law.part("record").get("cut", False)),
            law.title,
            law.exact,
            bool(law.scale["f"]) and forward > 0.0,
            _not_described(law, read),
            {term: _not_stated(law, read, term) for term in "PID"},
            read.one("full_throttle", FULL_THROTTLE),
            _low_tpa(read),
        )

    @property
    def changes_in_flight(self) -> bool:
        """Whether parts of it move by more than the throttle's TPA."""
        return bool(self.boost or self.relax or self.moving or self.faster or self.throttle_of == "mixer")

    def kept(self, throttle: FloatArray) -> FloatArray:
        """(N,) what TPA leaves of its terms."""
        above = taper(throttle, *self.tpa, self.full_throttle)
        below = taper(-throttle, self.low_tpa[0], -self.low_tpa[1], -NO_THROTTLE)
        return np.asarray(1.0 - above - below)

    def filters_at(self, lowpass_hz: float) -> Filters:
        """The derivative's low-passes with the moving one at a cut-off (Hz)."""
        moved = filters_of(self.moving.kind, lowpass_hz) if self.moving else ()
        return moved + self.filters[len(moved) :]

    def weighed(self, setpoint: FloatArray, stick: FloatArray) -> FloatArray:
        """(N,) the setpoint whose derivative the controller takes."""
        share = np.minimum(stick / self.relaxed, 1.0) if self.relaxed else 1.0
        return np.asarray(self.weight * share * setpoint)

    def controller(self, flown: Conditions) -> Controller:
        """In small motions, with what moves as it was on average over a flight."""
        late = flown.slower
        means = flown.means or self._means_of_tpa(flown.throttle)
        weight = self.weight
        steps = np.diff(flown.setpoint)
        if self.relaxed and steps.any():
            weight = float(steps @ np.diff(self.weighed(flown.setpoint, flown.stick)) / (steps @ steps))
        of_d, of_i = (late if stated else 1.0 for stated in self.stated_steps)
        filters = self.filters
        if means.lowpass_hz is not None:
            filters = self.filters_at(means.lowpass_hz)
        return Controller(
            self.stated,
            self.p * means.p,
            self.i * means.i / of_i,
            self.d * means.d * of_d,
            weight,
            tuple((order, cut / late) for order, cut in filters),
            notch=(self.notch[0] / late, self.notch[1] / late),
            slope_filtered=self.slope_filtered,
            p_filters=tuple((order, cut / late) for order, cut in self.p_filters),
            recorded_forward=flown.forward,
            i_at_rest=self.i / of_i,
            law=self.title,
            exact=self.exact,
        )

    def _means_of_tpa(self, throttle: FloatArray) -> Means:
        kept = float(self.kept(throttle).mean()) if len(throttle) else 1.0
        p, d = (kept if term in self.tpa_terms else 1.0 for term in "PD")
        return Means(p, 1.0, d)


def betaflight(settings: Mapping[str, str], axis: str, flown: Conditions) -> Controller:
    """The controller of an axis, see `BetaflightLaw`."""
    return BetaflightLaw.of(settings, axis).controller(flown)


@dataclass(frozen=True)
class _Header:
    """A header's settings under the names that a law uses."""

    law: Law
    settings: Mapping[str, str]

    def several(self, name: str) -> tuple[float, ...]:
        """The numbers of a setting; none where the header does not state it."""
        return stated_numbers(self.settings, *self.law.names.get(name, ()))

    def one(self, name: str, otherwise: float) -> float:
        """The first number of a setting, or another value."""
        return stated_number(self.settings, *self.law.names.get(name, ()), otherwise=otherwise)

    def lost(self, roles: Sequence[str]) -> tuple[str, ...]:
        """Settings that the header does not state, by their newest names."""
        return tuple(self.law.names[role][0] for role in roles if not self.several(role))

    def needed(self, name: str) -> tuple[float, ...]:
        """The numbers of a setting that the law cannot do without."""
        return needed_numbers(self.settings, *self.law.names[name])


def _not_described(law: Law, read: _Header) -> tuple[str, ...]:
    """Settings of this log that change the law in a way that its entry leaves out."""
    switched = [
        f"{what} ({name})"
        for name, what in law.not_described.items()
        if stated_number(read.settings, name, otherwise=0.0)
    ]
    known = len(law.part("derivative")["kinds"])
    types = [role for role in ("lowpass_1_type", "lowpass_2_type") if read.one(role, 0.0) >= known]
    return (*switched, *(f"D low-pass type {read.one(role, 0.0):g}" for role in types))


def _not_stated(law: Law, read: _Header, term: str) -> tuple[str, ...]:
    """Settings that move a term and are not in the header: lost, or never in one of the version."""
    return (*read.lost(law.part("expected").get(term, ())), *law.part("unstated").get(term, ()))


def _kind(law: Law, read: _Header, name: str) -> str:
    """Of a low-pass, by its number; the first kind for one that the version does not know."""
    kinds = law.part("derivative")["kinds"]
    number = int(read.one(name, 0.0))
    return str(kinds[number]) if number < len(kinds) else str(kinds[0])


def _lowpasses(law: Law, read: _Header, moving: Moving | None) -> Filters:
    """Of the derivative: the first at its lower cut-off where it moves, and the second."""
    first = moving.low if moving else read.needed("lowpass_1")[0]
    second = read.one("lowpass_2", 0.0)
    if law.names.get("lowpass_2") and not law.part("derivative").get("second_optional", False):
        (second, *_) = read.needed("lowpass_2")
    kinds = (_kind(law, read, f"lowpass_{number}_type") for number in (1, 2))
    return tuple(own for kind, hz in zip(kinds, (first, second), strict=True) for own in filters_of(kind, hz))


def _moving(law: Law, read: _Header) -> Moving | None:
    """How the first low-pass follows the throttle; None where it does not."""
    found = read.several("lowpass_1_moving")
    if len(found) < 2 or found[0] <= 0.0:
        return None
    expo = read.one("lowpass_1_expo", float(law.part("moving")["expo"]))
    return Moving(_kind(law, read, "lowpass_1_type"), found[0], found[1], expo)


def _boost(law: Law, read: _Header, axis: str, d: float) -> tuple[float, Boost | None]:
    """The least D, and how it grows; the stated D and nothing where it does not."""
    how = law.part("boost")
    other = _of_axis(read.several("boost_other"), axis)
    if not how:
        return d, None
    least, most = (other, d) if how["other"] == "least" else (d, other)
    if not 0.0 < least < most:
        return d, None
    gain = float(how["factor"]) * read.one("boost_gain", 0.0) / float(how["smooth_hz"])
    return least, Boost(
        most / least,
        gain,
        gain * read.one("boost_advance", 0.0) / 100.0,
        filters_of(str(how["range_kind"]), float(how["range_hz"])),
        filters_of(str(how["smooth_kind"]), float(how["smooth_hz"])),
    )


def _relax(law: Law, read: _Header, axis: str) -> Relax | None:
    """The relaxed integral of an axis; None where it is off, or goes by the gyro."""
    how = law.part("integral")
    threshold = float(how["relax_threshold"])
    mode = read.one("relax", float(how.get("relax_default", 0.0)))
    kind = read.one("relax_type", RELAXED_BY_SETPOINT)
    if (
        not threshold
        or not mode
        or kind != RELAXED_BY_SETPOINT
        or (axis == "yaw" and mode not in RELAXED_YAW)
    ):
        return None
    cut = read.one("relax_cutoff", float(how.get("relax_default_hz", 0.0)))
    reference = float(how.get("relax_reference_hz", 0.0))
    return Relax(cut, threshold * reference / cut if reference else threshold) if cut > 0.0 else None


def _anti_gravity(
    kind: str, read: _Header, axis: str, settings: Mapping[str, str]
) -> tuple[tuple[float, float], AntiGravity | None]:
    """Factor and threshold of the older kind; what the newer kinds need."""
    off = (1.0, np.inf)
    if kind == "none" or not int(stated_number(settings, "features", otherwise=0.0)) & ANTI_GRAVITY:
        return off, None
    gain = read.one("anti_gravity_gain", 1000.0 if kind == "steps" else 0.0)
    if kind == "steps":
        return (gain / 1000.0, read.one("anti_gravity_threshold", np.inf)), None
    if axis == "yaw":
        return off, None
    cut = read.one("anti_gravity_cutoff", 0.0)
    return off, AntiGravity(kind, gain, cutoff_hz=cut, p=read.one("anti_gravity_p", 0.0))


def _tpa_terms(law: Law, read: _Header, axis: str) -> tuple[str, ...]:
    """Terms that TPA shrinks: of the mode where the header states it, else as the law has them."""
    if axis == "yaw" and law.part("throttle").get("leaves_yaw", False):
        return ()
    mode = read.several("tpa_mode")
    if not mode:
        return tuple(law.part("throttle")["terms"])
    return ("D",) if mode[0] == 1.0 else ("P", "D")


def _low_tpa(read: _Header) -> tuple[float, float]:
    """Share and end of TPA below a throttle, where it stays on in flight.

    Without `tpa_low_always` it is gone for good once the throttle has passed its end: before the flight.
    """
    if not read.one("tpa_low_always", 0.0):
        return 0.0, NO_THROTTLE
    ends = min(read.one("tpa_low_breakpoint", NO_THROTTLE), read.one("tpa_breakpoint", FULL_THROTTLE))
    return read.one("tpa_low_rate", 0.0) / 100.0, ends


def _of_axis(values: tuple[float, ...], axis: str) -> float:
    """Of three values that of an axis; 0 where there are none."""
    return values[list(AXES).index(axis)] if len(values) == len(AXES) else 0.0


def _name_gains(
    axis: str, p: float, i: float, d: float, least: float, forward: float, has_forward: bool
) -> dict[str, float]:
    """As people know them."""
    named = {f"{AXES[axis]} P": p, "I": i, "D": d}
    if least < d:
        named["D least"] = least
    return named | ({"F": forward} if has_forward else {})
