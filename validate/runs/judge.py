"""A run's models against each other on its held-out part."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import Any

from flysid.catalogue import FlightFacts
from flysid.errors import DataError
from flysid.extras import Extra, Missing, extra
from flysid.ingest.lake.chosen_flights import Selection
from flysid.ingest.lake.lake import Lake
from flysid.ingest.lake.lake import open as open_lake
from flysid.loops.judged import Judged, judge, states_gains
from flysid.progress import tell
from flysid.validate.compare.comparison import Comparison
from flysid.validate.compare.models import across_channels, compare_models
from flysid.validate.diagnose.caution import Caution
from flysid.validate.diagnose.cautions import cautions
from flysid.validate.diagnose.context import ReportContext
from flysid.validate.diagnose.document import plain, to_json
from flysid.validate.runs.fitone import nothing_done
from flysid.validate.runs.judgedparts import chosen_lake, restrict
from flysid.validate.runs.provenance import FIT_TIME, fit_command, provenance_of
from flysid.validate.runs.run import Beside, HeldOut, Run, held_out, requested_model, with_models


@dataclass(frozen=True)
class Judgement:
    """What was found on the held-out part.

    Attributes
    ----------
    comparisons : by channel, corrected over channels.
    skipped : channels that are not in `comparisons`, with the reason.
    context : all that the page is drawn from.
    unjudged : those of `skipped` that were fitted, and should have been judged.
    """

    run: Run
    comparisons: Mapping[str, Comparison]
    skipped: Mapping[str, str]
    context: ReportContext
    unjudged: tuple[str, ...] = ()

    @property
    def document(self) -> dict[str, Any]:
        """The comparison as JSON types: {"channels": {NAME: {HORIZON: {...}}}, ...}.

        "missing" holds a sentence on every extra that could not be given; it is not there where none is.
        """
        context = self.context
        with context.missing.gathering():
            found = to_json(self.comparisons, context.diagnoses, context.doubts) | {
                "skipped": dict(self.skipped),
                "provenance": {k: v for k, v in context.provenance.items() if not k.endswith(FIT_TIME)},
                "gains": extra(Extra.GAINS, lambda: plain([j.to_dict() for j in context.loops]), ()),
                "fit_seconds": {name: dict(times) for name, times in context.fit_seconds.items()},
            }
        return found | context.missing.to_dict()

    @property
    def cautions(self) -> tuple[Caution, ...]:
        """What to beware of, worst first; as on the page."""
        with self.context.missing.gathering():
            return cautions(self.comparisons, self.context.diagnoses, self.context.doubts)


def judge_run(
    run: Run,
    data: str | Path | None = None,
    only: Selection | None = None,
    beside: Beside = MappingProxyType({}),
) -> Judgement:
    """Compare every channel of a run on its held-out part; tells of its progress (`flysid.progress`).

    `data`: the ingested folder, where it moved since the fit.
    `only`: judge on these of the held-out flights and stretches alone.
    `beside`: further models, by channel and label, that are judged on the same flights as the run's.
    Raises DataError: no channel can be judged, or the data differs from what was fitted.
    Raises StoreError, UsageError: the run or the data folder cannot be read.
    """
    chosen = None if only is None else chosen_lake(run, data, only)  # from the catalogue: before tables
    missing = Missing(*run.missing)
    held = _load(run, data, beside, missing)
    comparisons, failed = _compare(run, held, chosen)
    skipped = {**run.skipped, **{name: error.advice for name, error in failed.items()}}
    context = replace(_context(run, data, only, held, comparisons, missing), skipped=skipped)
    return Judgement(run, comparisons, skipped, context, tuple(failed))


def _load(run: Run, data: str | Path | None, beside: Beside, missing: Missing) -> list[HeldOut]:
    """The held-out part of every channel, with the run's models and those beside them."""
    tell("aligning the held-out part", share=0.0)
    with missing.gathering():
        return [with_models(item, beside.get(item.channel.name, {})) for item in held_out(run, data)]


def _compare(
    run: Run, held: Sequence[HeldOut], chosen: Lake | None
) -> tuple[Mapping[str, Comparison], dict[str, DataError]]:
    """The comparisons by channel, corrected over channels; and why others could not be judged.

    Raises DataError: no channel can be judged.
    """
    comparisons: dict[str, Comparison] = {}
    failed: dict[str, DataError] = {}
    for i, item in enumerate(held):
        tell("comparing on held-out segments", channel=item.channel.name, share=(i + 1) / (len(held) + 1))
        try:
            judged = item if chosen is None else restrict(item, chosen)
            comparisons[item.channel.name] = compare_models(
                item.models,
                judged.test,
                baseline=item.channel.baseline,
                contender=requested_model(run.settings.labels, item.models, item.channel.baseline),
                seen=item.seen,
                turns=judged.turns,
            )
        except DataError as error:
            failed[item.channel.name] = error
    if not comparisons:
        raise nothing_done(run.recipe, "judged", {name: str(error) for name, error in failed.items()})
    return across_channels(comparisons), failed


def _context(
    run: Run,
    data: str | Path | None,
    only: Selection | None,
    held: Sequence[HeldOut],
    comparisons: Mapping[str, Comparison],
    missing: Missing,
) -> ReportContext:
    """What the page shows beside the comparisons: training data, flights, doubts, loops, provenance."""
    judged_with = [] if only is None else [f"judged with {' '.join(only.options)}"]
    remarks = [run.settings.remark] if run.settings.remark else []
    with missing.gathering():
        return ReportContext(
            comparisons=comparisons,
            train={h.channel.name: h.train for h in held},
            command=f"{fit_command(run)} -o RUN && flysid validate RUN",
            provenance=provenance_of(run, held),
            remark="; ".join([*remarks, *judged_with]),
            fit_seconds={h.channel.name: dict(h.channel.fit_seconds) for h in held},
            flights=extra(Extra.FLIGHTS, partial(_flights, run, data), ()),
            doubts={h.channel.name: h.channel.doubts for h in held if h.channel.name in comparisons},
            loops=extra(Extra.GAINS, partial(_loops, run, data), ()),
            missing=missing,
        )


def _flights(run: Run, data: str | Path | None) -> tuple[FlightFacts, ...]:
    """What the catalogue knows of the run's flights; a dataset file has none."""
    return open_lake(data or run.data).only(run.flights).facts if run.recipe else ()


def _loops(run: Run, data: str | Path | None) -> tuple[Judged, ...]:
    """What the gains in the logs of the run's flights mean; nothing where no axis could be judged."""
    if not run.recipe:
        return ()
    logs = [log for log in open_lake(data or run.data).only(run.flights).logs if states_gains(log)]
    if logs:
        tell("measuring the loops of the logged gains")
    found = judge(logs)
    return tuple(found) if any(j.margins is not None for j in found) else ()
