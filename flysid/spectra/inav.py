"""The gyro's filters of INAV, from the settings in a blackbox header.

A header states the cut-off of the main low-pass, which runs with every PID loop, and the RPM notches. It
does not state what else was on: `flysid/laws/inav.toml` lists those settings by version.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from flysid.errors import DataError
from flysid.ingest.lake.headers import WHOLE, needed_numbers, stated_number
from flysid.laws.described import Law, blackbox_law
from flysid.spectra.chain import Chain, Step
from flysid.spectra.stages import Kind, Stage

REMEDY = "INAV logs cannot show them: `diff all` on its command line does"


def inav_chain(settings: Mapping[str, str], slower: float) -> Chain:
    """The gyro's filters as far as a header states them.

    `settings`: of the header, by name.
    `slower`: real time of an iteration over the nominal one.
    Raises DataError: the header is of a version whose filters are not described, or has lost `looptime` or
    the main low-pass.
    """
    law = blackbox_law(settings["Firmware revision"])
    gyro = law.part("gyro")
    if not gyro:
        raise DataError(
            f"the gyro filters of {law.title} are not known here",
            hint="those of INAV 6 and later are; the spectrum itself: flysid spectrum LOG",
        )
    looptime = needed_numbers(settings, "looptime")[0]
    if looptime <= 0.0:
        raise DataError(f"the log's header states {looptime:g} for looptime", hint=WHOLE)
    hz = needed_numbers(settings, gyro["lowpass"])[0]
    low = Stage(Kind(gyro["lowpass_kind"]), hz / slower)
    words = f"{gyro['lowpass_words']} {low.kind} {hz:g} Hz"
    steps = (Step(low, 1e6 / (looptime * slower), words),) if hz > 0.0 else ()
    return Chain(steps, (*_rpm_notches(settings), *_not_stated(law, gyro["unstated"])), remedy=REMEDY)


def _rpm_notches(settings: Mapping[str, str]) -> list[str]:
    """The log has the mean of the motors' RPM at best."""
    on = stated_number(settings, "rpm_gyro_filter_enabled", otherwise=0.0)
    harmonics = stated_number(settings, "rpm_gyro_harmonics", otherwise=0.0)
    if not on or not harmonics:
        return []
    return [f"{harmonics:g} RPM notches for each motor: the log does not hold the motors' RPM"]


def _not_stated(law: Law, names: Sequence[str]) -> list[str]:
    """Settings of filters that may have been on, or of how the main one moved; and whose law stands in."""
    lacking = ", ".join(names)
    found = f"{lacking}: no header of {law.firmware} states them, and the main low-pass counts as at rest"
    return [found] if law.exact else [law.title, found]
