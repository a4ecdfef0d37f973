"""The rate controller of Betaflight 3.1 to 3.5: what a header states, and what it comes to in small motions.

In whole numbers of the mixer, 1000 for the motors' range, with the error e = r - y:

    P: 0.032029 p e      I: 0.244381 i integral of e
    D: 0.000529 d (w r - F y)'    since 3.2        0.000529 d F (w r - y)'    in 3.1

F are the derivative's filters: first order (PT1) or second (biquad), a notch. The setpoint's weight w is
w0 min(|stick| / ratio, 1) where the header states a ratio between 0 and 1. Above a throttle of
`tpa_breakpoint` P and D shrink (TPA). The integral slows down while the axes ask for more than a share of the
motors' range (windup), and runs faster while the throttle moves (anti-gravity).

The loop's steps take longer than the header says where the gyro's clock or the processor is slow: filters
are those of the stated step, and in 3.1 so are integral and derivative; later ones measure it.

Source: Betaflight's pid.c of 3.1.7 and 3.4.0, held against the terms that logs of 3.1.3 and 3.4.0 record.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from flysid.dataset import FloatArray
from flysid.errors import DataError
from flysid.loops.controller import Controller, Filters

P_SCALE = 0.032029
I_SCALE = 0.244381
D_SCALE = 0.000529
AXES = {"roll": "rollPID", "pitch": "pitchPID", "yaw": "yawPID"}
FULL_THROTTLE = 2000.0
"""us."""
ANTI_GRAVITY = 1 << 28
"""Bit of `features` that switches it on."""
LARGEST_I = 250.0
"""Of the integral where the header states none: 3.1. Since 3.2 it is 150."""
LARGEST_I_SINCE = 150.0


@dataclass(frozen=True, eq=False)
class Conditions:
    """What the gains of one flight depended on.

    Attributes
    ----------
    throttle : (N,) us.
    setpoint, stick : (N,) deg/s, and the stick's way from its middle, 0 to 1.
    slower : steps of the loop over those that the header states.
    """

    throttle: FloatArray
    setpoint: FloatArray
    stick: FloatArray
    slower: float = 1.0


NO_CONDITIONS = Conditions(np.zeros(0), np.zeros(0), np.zeros(0))


@dataclass(frozen=True)
class BetaflightLaw:
    """What a header states of one axis.

    Attributes
    ----------
    stated : gains as the firmware names them.
    p, i, d : the same in the mixer's numbers.
    weight, relaxed : of the setpoint in the derivative, and the stick up to which it grows; 0: it does not.
    filters, notch : orders and cut-offs (Hz), and centre and cut-off, of what the derivative goes through.
    stated_steps : whether the setpoint goes through the filters too, and steps are taken as stated: 3.1.
    step_s : stated; 0 where it is not.
    tpa : share that it takes of P and D at full throttle, and where it begins, us.
    windup : share of the motors' range beyond which the integral slows down.
    anti_gravity : factor of the integral while the throttle moves by more than a threshold (us) in 0.1 s.
    limits : of the outputs of roll, pitch and yaw.
    largest_i : of the integral.
    """

    stated: Mapping[str, float]
    p: float
    i: float
    d: float
    weight: float
    relaxed: float
    filters: Filters
    notch: tuple[float, float]
    stated_steps: bool
    step_s: float
    tpa: tuple[float, float]
    windup: float
    anti_gravity: tuple[float, float]
    limits: tuple[float, float, float]
    largest_i: float

    @classmethod
    def of(cls, settings: Mapping[str, str], axis: str) -> BetaflightLaw:
        """Of an axis, from a header's settings.

        Raises
        ------
        DataError : another firmware or version, a gain or filter that is missing.
        """
        version = _version(settings)
        p, i, d = _numbers(settings, AXES[axis])
        hundredths = version >= (3, 4) or version < (3, 2)
        (weight,) = _numbers(settings, "dterm_setpoint_weight", "dtermSetpointWeight")
        (relaxed,) = _numbers(settings, "setpoint_relaxation_ratio", "setpointRelaxRatio")
        cut = _numbers(settings, "dterm_lowpass_hz", "dterm_lpf_hz")[0]
        second = _numbers(settings, "dterm_lowpass2_hz")[0] if version >= (3, 4) else 0.0
        first = 2 if _numbers(settings, "dterm_filter_type")[0] == 1 else 1
        roll = _number(settings, 1000.0, "pidsum_limit", "pidSumLimit")
        yaw = _number(settings, 1000.0, "pidsum_limit_yaw", "pidSumLimitYaw")
        anti_gravity = (1.0, np.inf)
        if version >= (3, 4) and int(_number(settings, 0.0, "features")) & ANTI_GRAVITY:
            faster = _number(settings, 1000.0, "anti_gravity_gain") / 1000.0
            anti_gravity = (faster, _number(settings, np.inf, "anti_gravity_threshold"))
        return cls(
            {f"{AXES[axis]} P": p, "I": i, "D": d},
            P_SCALE * p,
            I_SCALE * i,
            D_SCALE * d,
            weight / (100.0 if hundredths else 127.0),
            relaxed / 100.0 if relaxed < 100.0 else 0.0,
            tuple((order, cut) for order, cut in ((first, cut), (1, second)) if cut > 0.0),
            (_number(settings, 0.0, "dterm_notch_hz"), _number(settings, 0.0, "dterm_notch_cutoff")),
            version < (3, 2),
            1e-6 * _number(settings, 0.0, "looptime") * _number(settings, 1.0, "pid_process_denom"),
            (
                _number(settings, 0.0, "tpa_rate", "dynThrPID") / 100.0,
                _number(settings, FULL_THROTTLE, "tpa_breakpoint"),
            ),
            _number(settings, 100.0, "iterm_windup", "itermWindupPointPercent") / 100.0,
            anti_gravity,
            (roll, roll, yaw),
            LARGEST_I if version < (3, 2) else LARGEST_I_SINCE,
        )

    def kept(self, throttle: FloatArray) -> FloatArray:
        """(N,) what TPA leaves of P and D."""
        share, begins = self.tpa
        if begins >= FULL_THROTTLE:
            return np.ones(len(throttle))
        return np.asarray(1.0 - share * np.clip((throttle - begins) / (FULL_THROTTLE - begins), 0.0, 1.0))

    def weighed(self, setpoint: FloatArray, stick: FloatArray) -> FloatArray:
        """(N,) the setpoint whose derivative the controller takes."""
        share = np.minimum(stick / self.relaxed, 1.0) if self.relaxed else 1.0
        return np.asarray(self.weight * share * setpoint)

    def controller(self, flown: Conditions) -> Controller:
        """In small motions, P, D and the setpoint's weight as they were on average over a flight."""
        late = flown.slower
        kept = float(self.kept(flown.throttle).mean()) if len(flown.throttle) else 1.0
        weight = self.weight
        steps = np.diff(flown.setpoint)
        if self.relaxed and steps.any():
            weight = float(steps @ np.diff(self.weighed(flown.setpoint, flown.stick)) / (steps @ steps))
        by_step = late if self.stated_steps else 1.0
        return Controller(
            self.stated,
            self.p * kept,
            self.i / by_step,
            self.d * kept * by_step,
            weight,
            tuple((order, cut / late) for order, cut in self.filters),
            notch=(self.notch[0] / late, self.notch[1] / late),
            slope_filtered=self.stated_steps,
        )


def betaflight(settings: Mapping[str, str], axis: str, flown: Conditions) -> Controller:
    """The controller of an axis, see `BetaflightLaw`."""
    return BetaflightLaw.of(settings, axis).controller(flown)


def _version(settings: Mapping[str, str]) -> tuple[int, int]:
    revision = settings.get("Firmware revision", "")
    found = re.match(r"Betaflight (\d+)\.(\d+)", revision)
    if not found or not (3, 1) <= (version := (int(found[1]), int(found[2]))) <= (3, 5):
        raise DataError(
            f"the controller of {revision or 'an unnamed firmware'} is not known here",
            hint="gains of Betaflight 3.1 to 3.5 are; the loop itself: flysid tf LOG -r betaflight-rate",
        )
    return version


def _number(settings: Mapping[str, str], otherwise: float, *names: str) -> float:
    """The first of these settings that the header states, or another value."""
    return next((float(settings[name]) for name in names if settings.get(name)), otherwise)


def _numbers(settings: Mapping[str, str], *names: str) -> tuple[float, ...]:
    for name in names:
        text = settings.get(name)
        if text:
            return tuple(float(part) for part in re.split("[,/]", text))
    raise DataError(f"the log's header does not state {names[0]}", hint="log with the header whole")
