"""Propose a notch for a tone that the filters leave in place, with the effect it would have."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from flysid.errors import DataError
from flysid.ingest.lake.headers import stated_numbers
from flysid.reviews.fact import Action, Change
from flysid.reviews.logged import LoggedFlight
from flysid.showing import significant
from flysid.spectra.causes import STAYS
from flysid.spectra.chain import Chain, Step
from flysid.spectra.peaks import Peak
from flysid.spectra.spectrum import Windows
from flysid.spectra.stages import Kind, Stage

LEAST_GAIN = 0.2
"""Of the noise behind the filters: a notch that takes away less is not worth its delay."""
Proposal = tuple[tuple[Change, ...], Stage]


def propose_notch(
    flight: LoggedFlight, chain: Chain, windows: Windows, peak: Peak, above_hz: float, phase_hz: float
) -> Action | None:
    """A static notch at a peak that stays where it is; None where the log does not show that it helps.

    `windows`, `peak`: of the gyro before its filters.
    `above_hz`: what is slower is the vehicle's motion.
    `phase_hz`: at which its cost is stated.
    """
    made = _FIRMWARES.get(flight.family)
    if made is None or chain.unknown or peak.hz < 2.0 * above_hz:
        return None
    if not peak.cause.startswith(STAYS.partition(":")[0]):
        return None
    proposal = made(flight, peak)
    if proposal is None:
        return None
    changes, stage = proposal
    rate = chain.steps[-1].rate_hz if chain.steps else windows.rate_hz
    tried = chain.with_steps([Step(stage, rate, stage.words)])
    noise = windows.hz >= above_hz
    hz, density = windows.hz[noise], windows.mean[noise]
    left = tried.noise_left(hz, density) / chain.noise_left(hz, density)
    if left > 1.0 - LEAST_GAIN:
        return None
    cost = tried.phase_deg(phase_hz) - chain.phase_deg(phase_hz)
    return Action(
        f"Set a notch at {significant(peak.hz)} Hz",
        f"the gyro shakes by {significant(peak.rms)} deg/s there before its filters; the tone {peak.cause}",
        changes,
        f"gyro noise above {above_hz:g} Hz behind the filters -{100.0 * (1.0 - left):.0f} %",
        f"{abs(cost):.1f} deg of phase at {phase_hz:g} Hz",
        min(1.0, 0.3 + 0.5 * (1.0 - left)),
        "vibration.peak",
    )


def _width(peak: Peak) -> float:
    """Wide enough for the peak, and half its frequency at most."""
    return float(np.clip(peak.band[1] - peak.band[0], peak.hz / 5.0, peak.hz / 2.0))


def _px4(flight: LoggedFlight, peak: Peak) -> Proposal | None:
    free = [k for k in (0, 1) if flight.parameters.get(f"IMU_GYRO_NF{k}_FRQ") == 0.0]
    if not free:
        return None
    stem, width = f"IMU_GYRO_NF{free[0]}", round(_width(peak))
    changes = (
        Change(f"{stem}_FRQ", 0.0, round(peak.hz), "Hz"),
        Change(f"{stem}_BW", flight.parameters.get(f"{stem}_BW", 20.0), width, "Hz"),
    )
    return changes, Stage(Kind.NOTCH, float(round(peak.hz)), q=peak.hz / width)


def _ardupilot(flight: LoggedFlight, peak: Peak) -> Proposal | None:
    free = [stem for stem in ("INS_HNTCH", "INS_HNTC2") if flight.parameters.get(f"{stem}_ENABLE") == 0.0]
    if not free:
        return None
    stem, width = free[0], round(_width(peak))
    changes = (
        Change(f"{stem}_ENABLE", 0.0, 1.0),
        Change(f"{stem}_MODE", flight.parameters.get(f"{stem}_MODE", 1.0), 0.0),
        Change(f"{stem}_FREQ", flight.parameters.get(f"{stem}_FREQ", 80.0), round(peak.hz), "Hz"),
        Change(f"{stem}_BW", flight.parameters.get(f"{stem}_BW", 40.0), width, "Hz"),
        Change(f"{stem}_HMNCS", flight.parameters.get(f"{stem}_HMNCS", 3.0), 1.0),
    )
    return changes, Stage(Kind.NOTCH, float(round(peak.hz)), q=peak.hz / width, left=0.01)


def _betaflight(flight: LoggedFlight, peak: Peak) -> Proposal | None:
    try:
        stated = stated_numbers(flight.headers, "gyro_notch_hz")
    except DataError:
        return None  # which of them is free is not known
    free = [k for k, hz in enumerate(stated) if hz == 0.0]
    if not free:
        return None
    name, edge = f"gyro_notch{free[0] + 1}", round(peak.hz - _width(peak) / 2.0)
    centre = float(round(peak.hz))
    q = centre * edge / (centre**2 - edge**2)
    return (Change(f"{name}_hz", 0.0, centre, "Hz"), Change(f"{name}_cutoff", 0.0, edge, "Hz")), Stage(
        Kind.NOTCH, centre, q=q
    )


_FIRMWARES: dict[str, Callable[[LoggedFlight, Peak], Proposal | None]] = {
    "px4": _px4,
    "ardupilot": _ardupilot,
    "betaflight": _betaflight,
}
