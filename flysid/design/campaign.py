"""Many trial flights of a design beside the present gains, and what came of them."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from flysid.dataset import FloatArray
from flysid.design.designed import SAID, Axis
from flysid.design.drawn_plants import grid
from flysid.design.firmware import SCHEMES, Firmware
from flysid.design.law import ComplexArray, Gains, LoopParts
from flysid.design.loopfigures import Laws, figures
from flysid.design.trialflight import (
    AXES,
    PERIOD_S,
    Doubtful,
    Flown,
    Trial,
    fly_trial,
    held_wind_m_s,
    true_plants,
)
from flysid.errors import UsageError
from flysid.ingest.synth.rigid_body import SimulatedVehicle
from flysid.progress import tell

BETTER = 0.8


@dataclass(frozen=True)
class Row:
    """One law on one axis over all trials.

    `ise`: median and 90th percentile, m^2 s.
    `better`, `worse`: shares of trials with at least 20 % less ISE than the present gains; with more. NaN
        where the present gains were not flown.
    `ms`: median and largest, on the true vehicles about hover.
    `stable`: on all of them.
    `overshoot`, `settled_s`: medians; NaN where most did not settle.
    `moved`: median of the input's total variation, deg/s.
    `saturated`: mean share of samples at the input's limit.
    `lost`, `blown`: trials that crashed; that the wind carried off, see `Flown`.
    """

    law: str
    ise: tuple[float, float]
    better: float
    worse: float
    ms: tuple[float, float]
    stable: bool
    overshoot: float
    settled_s: float
    moved: float
    saturated: float
    lost: int
    blown: int


@dataclass(frozen=True, eq=False)
class Campaign:
    """All trials.

    `flown`: law -> trial -> axis.
    `rows`: axis -> law by law.
    `drawn`: what differs from vehicle to vehicle, by name: ends of a range, or a number.
    `held_wind_m_s`: that full tilt holds, by axis; of simulated vehicles.
    `notes`: sentences.
    """

    vehicles: int
    seed: int
    drawn: Mapping[str, Any]
    laws: Mapping[str, Mapping[str, Gains]]
    flown: Mapping[str, Sequence[Mapping[str, Flown]]]
    rows: Mapping[str, Sequence[Row]]
    held_wind_m_s: Mapping[str, float]
    notes: tuple[str, ...]

    def ratios(self, law: str, axis: str) -> FloatArray:
        """(vehicles,) ISE over that of the present gains in the same trial, rising."""
        own = np.array([f[axis].ise for f in self.flown[law]])
        return np.sort(own / np.array([f[axis].ise for f in self.flown["present"]]))

    def to_dict(self) -> dict[str, Any]:
        """JSON types only."""
        return {
            "vehicles": self.vehicles,
            "seed": self.seed,
            "drawn": dict(self.drawn),
            "held_wind_m_s": dict(self.held_wind_m_s),
            "laws": {a: {n: g.to_dict() for n, g in laws.items()} for a, laws in self.laws.items()},
            "axes": {
                axis: [{k: _known(v) for k, v in asdict(row).items()} for row in rows]
                for axis, rows in self.rows.items()
            },
            "notes": list(self.notes),
        }

    def table(self, axis: str) -> list[tuple[str, ...]]:
        """Rows of words, the first of headings."""
        head = ("", "ISE median, 90 %", ">= 20 % less", "more", "true Ms", "overshoot", "settled",
                "input moves", "saturated", "lost", "blown off")  # fmt: skip
        rows: list[tuple[str, ...]] = [head]
        for r in self.rows[axis]:
            settled = "-" if math.isnan(r.settled_s) else f"{r.settled_s:.1f} s"
            rows.append(
                (SAID[r.law], f"{r.ise[0]:.1f}, {r.ise[1]:.0f}", _share(r.better), _share(r.worse),
                 f"{r.ms[0]:.2f}, at most {r.ms[1]:.2f}" if r.stable else "unstable", _share(r.overshoot),
                 settled, f"{r.moved:.0f} deg/s", _share(r.saturated), str(r.lost), str(r.blown))
            )  # fmt: skip
        return rows


def _share(value: float) -> str:
    return "-" if math.isnan(value) else f"{100.0 * value:.0f} %"


def _known(value: Any) -> Any:
    return None if isinstance(value, float) and not math.isfinite(value) else value


def check_number(vehicles: int) -> None:
    """Raise UsageError for a number of vehicles that is not flown."""
    if not 1 <= vehicles <= 10_000:
        raise UsageError(f"{vehicles} vehicles", hint="1 to 10000")


def fly_design(axes: Sequence[Axis], vehicles: int, seed: int, doubtful: Doubtful) -> Campaign:
    """Fly every law of a design on the same simulated vehicles in the same wind.

    Raises UsageError: no channel of the design drives the simulated vehicle, at its sample time.
    """
    check_number(vehicles)
    laws, notes = _laws(axes)
    trials = [Trial.drawn(doubtful, seed, i) for i in range(vehicles)]
    flown: dict[str, list[dict[str, Flown]]] = {}
    names = list(laws["x"])
    for done, law in enumerate(names):
        tell(f"flying {SAID[law]}", share=done / (len(names) + 1))
        flown[law] = [fly_trial(t, (laws["x"][law], laws["y"][law]), doubtful) for t in trials]
    tell("margins of the true vehicles", share=len(names) / (len(names) + 1))
    omega = grid(PERIOD_S)
    true = [true_plants(t.vehicle, omega) for t in trials]
    parts = LoopParts.at(omega, PERIOD_S)
    rows = {
        axis: [
            row_of_law(law, laws[axis][law], axis, flown, np.array([t[axis] for t in true]), parts)
            for law in names
        ]
        for axis in AXES
    }
    return Campaign(
        vehicles, seed, asdict(doubtful), laws, flown, rows, held_wind_m_s(SimulatedVehicle()), notes
    )


def _laws(axes: Sequence[Axis]) -> tuple[dict[str, dict[str, Gains]], tuple[str, ...]]:
    """Axis -> law -> gains, the same laws on both axes."""
    published = _published_gains()
    by_input = {axis.input: axis for axis in axes}
    mine = {name: by_input.get(u) for name, u in AXES.items()}
    there = [a for a in mine.values() if a is not None]
    if not there:
        raise UsageError(
            f"the simulated vehicle is driven by {' and '.join(AXES.values())}, the design by "
            f"{' and '.join(by_input) or 'nothing'}",
            hint="fly it on the models of its run: --on RUN",
        )
    if any(abs(a.dt_s - PERIOD_S) > 1e-9 for a in there):
        raise UsageError(
            f"the design is for {1.0 / there[0].dt_s:g} Hz, the simulated link takes {1.0 / PERIOD_S:g} Hz"
        )
    notes = []
    names = [n for n in SAID if all(n in a.laws or n.startswith("present") for a in there)]
    laws: dict[str, dict[str, Gains]] = {}
    for name, axis in mine.items():
        own = dict(axis.laws) if axis is not None else {}
        if "present" not in own:
            own |= {"present": published, "present_x2": published.times(2.0)}
            notes.append(f"{name}: the published gains of tum_ardrone stand for the present ones")
        if axis is None:
            own |= dict.fromkeys(names, published)
            notes.append(f"{name}: not designed, flown with the published gains")
        if axis is not None and axis.sign < 0.0:
            raise UsageError(
                f"{axis.channel}: the output falls as {axis.input} rises; the simulated vehicle's rises"
            )
        laws[name] = {law: own[law] for law in names}
    return laws, tuple(notes)


def _published_gains() -> Gains:
    """The default of the AR.Drone's best known autopilot, on the simulated vehicle's limit of tilt."""
    scheme = SCHEMES["tum-ardrone"][0]
    limit = math.degrees(SimulatedVehicle().loop.tilt_max_rad)
    return Firmware("tum-ardrone", scheme, limit=limit).gains(scheme.published)


def row_of_law(
    law: str,
    gains: Gains,
    axis: str,
    flown: Mapping[str, Sequence[Mapping[str, Flown]]],
    true: ComplexArray,
    parts: LoopParts,
) -> Row:
    """What a law did on an axis over all trials.

    `flown`: law -> trial -> axis.
    `true`: (P, F) responses of the vehicles, at the frequencies of `parts`.
    """
    own = [f[axis] for f in flown[law]]
    ise = np.array([f.ise for f in own])
    base = np.array([f[axis].ise for f in flown["present"]]) if "present" in flown else None
    margins = figures(Laws.of(gains), true, parts)
    settled = np.array([math.inf if math.isnan(f.settled_s) else f.settled_s for f in own])
    middle = float(np.median(settled))
    return Row(
        law,
        (float(np.median(ise)), float(np.quantile(ise, 0.9))),
        math.nan if base is None else float(np.mean(ise <= BETTER * base)),
        math.nan if base is None else float(np.mean(ise > base)),
        (float(np.median(margins.ms)), float(margins.ms.max())),
        bool(margins.stable.all()),
        float(np.median([f.overshoot for f in own])),
        middle if math.isfinite(middle) else math.nan,
        float(np.median([f.moved for f in own])),
        float(np.mean([f.saturated for f in own])),
        sum(f.lost for f in own),
        sum(f.blown for f in own),
    )
