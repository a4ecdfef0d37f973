"""Linear models of groups of flights, from their triangles.

A linear model of any group (a vehicle, a firmware, both) needs the triangles alone.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from scipy import stats

from flysid.errors import DataError, UsageError
from flysid.extras import Extra, extra
from flysid.fleet.models.band import band_of
from flysid.fleet.models.common_grid import Sampling
from flysid.fleet.models.differences import FlightPart
from flysid.fleet.models.gather import Gathered
from flysid.fleet.models.groups import GroupModel, Response, fit_group, response_of
from flysid.fleet.models.scatter import Scatter, pool
from flysid.model.threads import on_one_thread
from flysid.showing import one_of

FORMAT = "flysid-fleet-fit"
FORMAT_VERSION = 1
KEYS = ("vehicle", "firmware", "month")


@dataclass(frozen=True, eq=False)
class Group:
    """A group of flights and its models of a channel, one per output.

    `key`: what the group is, e.g. {"vehicle": "px4 0042", "firmware": "1.15.2"}.
    `flights`: their ids.
    `models`: by output; empty where `reason` explains why there are none.
    `response`: of a channel with one input and one output.
    """

    key: Mapping[str, str]
    channel: str
    flights: tuple[str, ...]
    models: tuple[GroupModel, ...]
    response: Response | None
    reason: str = ""


@dataclass(frozen=True, eq=False)
class FleetFit:
    """All groups' models.

    `scatter`: by channel, between flights, pooled over the groups; absent where they have too few flights.
    `omega`: by channel, the frequencies of the responses, rad/s.
    """

    by: tuple[str, ...]
    samplings: Mapping[str, Sampling]
    groups: tuple[Group, ...]
    scatter: Mapping[str, Scatter]
    omega: Mapping[str, Any]
    skipped: Mapping[str, str]

    def document(self, recipe: str) -> dict[str, Any]:
        """Plain values, for JSON."""
        return {
            "format": FORMAT,
            "version": FORMAT_VERSION,
            "recipe": recipe,
            "by": list(self.by),
            "channels": {
                name: {
                    "dt_s": s.dt_s,
                    "lags": s.lags,
                    "inputs": s.inputs,
                    "outputs": s.outputs,
                    "units": s.units,
                }
                for name, s in self.samplings.items()
            },
            "groups": [self._group(group) for group in self.groups],
            "skipped": dict(self.skipped),
        }

    def _group(self, group: Group) -> dict[str, Any]:
        document: dict[str, Any] = {
            "group": dict(group.key),
            "channel": group.channel,
            "flights": group.flights,
        }
        if group.reason:
            return document | {"reason": group.reason}
        sampling = self.samplings[group.channel]
        document["models"] = [
            {
                "output": sampling.outputs[i],
                "theta": m.theta.tolist(),
                "covariance": None if m.covariance is None else m.covariance.tolist(),
                "rows": m.rows,
                "rmse": m.rmse,
                "condition": m.condition,
            }
            for i, m in enumerate(group.models)
        ]
        document["response"] = self._response(group)
        return document

    def _response(self, group: Group) -> dict[str, Any] | None:
        """Gain and phase, with 95 % intervals where the scatter between flights is known."""
        if group.response is None:
            return None
        omega = self.omega[group.channel]
        k = len(omega)
        value = group.response.value
        scatter = self.scatter.get(group.channel)
        reach = np.full(2 * k, np.nan)
        if scatter is not None:
            sigma = np.sqrt(np.diag(scatter.covariance(group.response)))
            reach = float(stats.t.isf(0.025, scatter.freedom)) * sigma
        return {
            "hz": (omega / 2.0 / np.pi).tolist(),
            "gain": np.exp(value[:k]).tolist(),
            "gain_95": None
            if scatter is None
            else np.exp([value[:k] - reach[:k], value[:k] + reach[:k]]).tolist(),
            "phase_deg": np.degrees(value[k:]).tolist(),
            "phase_95_deg": None
            if scatter is None
            else np.degrees([value[k:] - reach[k:], value[k:] + reach[k:]]).tolist(),
        }


def check_keys(by: Sequence[str]) -> None:
    """Raise UsageError for a key by which flights cannot be grouped."""
    for key in by:
        if key not in KEYS:
            raise UsageError(f"flights cannot be grouped by {key!r}", hint=one_of(list(KEYS), key))


@on_one_thread
def fit_groups(gathered: Gathered, by: Sequence[str]) -> FleetFit:
    """The linear models of all groups.

    `by`: some of `KEYS`; empty: the whole fleet is one group.
    Raises UsageError: another key.
    """
    check_keys(by)
    groups: list[Group] = []
    scatter: dict[str, Scatter] = {}
    omegas: dict[str, Any] = {}
    for channel, parts in gathered.parts.items():
        sampling = gathered.samplings[channel]
        useful = [p for p in parts if p.triangle.rows]
        omegas[channel] = _frequencies(useful, sampling, channel)
        found = [
            _group(dict(zip(by, key, strict=True)), channel, own, sampling, omegas[channel])
            for key, own in _grouped(useful, by).items()
        ]
        groups += found
        pooled = extra(Extra.SCATTER, partial(_pool, found, channel), None, channel)
        if pooled is not None:
            scatter[channel] = pooled
    return FleetFit(tuple(by), gathered.samplings, tuple(groups), scatter, omegas, gathered.skipped)


def _pool(groups: Sequence[Group], channel: str) -> Scatter | None:
    """The scatter between flights; None where there are too few, and no interval is given."""
    try:
        return pool([g.response for g in groups if g.response is not None], channel)
    except DataError:
        return None


def _frequencies(parts: Sequence[FlightPart], sampling: Sampling, channel: str) -> Any:
    if not parts or len(sampling.inputs) != 1 or len(sampling.outputs) != 1:
        return np.zeros(0)
    try:
        spectra = sum((p.triangle.spectra for p in parts[1:]), parts[0].triangle.spectra)
        return band_of(spectra, sampling.omega, 0, 1, channel).frequencies
    except DataError:
        return np.zeros(0)


def _grouped(parts: Sequence[FlightPart], by: Sequence[str]) -> dict[tuple[str, ...], list[FlightPart]]:
    found: dict[tuple[str, ...], list[FlightPart]] = {}
    for one in parts:
        found.setdefault(tuple(_value(one, key) for key in by), []).append(one)
    return {key: found[key] for key in sorted(found)}


def _value(one: FlightPart, key: str) -> str:
    if key == "month":
        return "" if one.start_ns is None else str(np.datetime64(one.start_ns, "ns").astype("datetime64[M]"))
    return one.vehicle if key == "vehicle" else one.firmware


def _group(
    key: Mapping[str, str], channel: str, own: Sequence[FlightPart], sampling: Sampling, omega: Any
) -> Group:
    flights = tuple(p.flight for p in own)
    rows = sum(p.triangle.rows for p in own)
    try:
        triangles = [p.triangle.r for p in own]
        models = tuple(fit_group(triangles, rows, sampling, i) for i in range(len(sampling.outputs)))
    except DataError as error:
        return Group(key, channel, flights, (), None, error.message)
    make = partial(response_of, models[0], sampling, omega)
    response = extra(Extra.GROUP_RESPONSE, make, None, channel) if len(omega) else None
    return Group(key, channel, flights, models, response)
