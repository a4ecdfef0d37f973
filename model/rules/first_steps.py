"""The first step of a search for rules: the data split, and linear models to start from."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace

from flysid.dataset import Dataset, FloatArray
from flysid.errors import DataError
from flysid.model.linear.settings import check_hint
from flysid.model.rules.families import Family, tolerant
from flysid.model.rules.judging import INTEGRATES, Candidate, hold_out
from flysid.model.rules.lag_orders import check, named_antecedents, order_choices
from flysid.model.rules.realisation import StateRealisation
from flysid.model.rules.regressor_layout import scaling
from flysid.model.rules.saturation import in_words, saturation_limits
from flysid.model.rules.search_context import SPARE_ROWS, SearchContext
from flysid.model.rules.search_record import Search
from flysid.model.rules.search_settings import RuleSettings
from flysid.model.rules.state_systems import linear_systems, system_stage
from flysid.model.rules.structure_choice import CLEARLY
from flysid.model.selection import parts_to_choose_on
from flysid.model.start import START_SHARE
from flysid.split import MIN_FLIGHTS

_HIGHEST_LINEAR = 12  # samples of lags that the linear side may choose on short records,
_DEEPEST_DELAY = 40  # and on long ones, delay included


def lag_starts(settings: RuleSettings, train: Dataset, validation: Dataset | None) -> Search:
    """The data split, and linear models of several orders."""
    check(settings)
    check_hint(settings.nk_hint, len(train.inputs))
    check_hint(settings.nk_least, len(train.inputs), "nk_least")
    choices = order_choices(settings, len(train.inputs))
    named = named_antecedents(settings, choices, train)
    deepest = _deepest(settings, train) if len(choices) > 1 else 0
    least = max(deepest, *(o.depth for o in choices), *(max(a.lag, a.minus) for a in named), 0) + SPARE_ROWS
    long = len(train) >= settings.search.short
    context, own = _context(settings, (train, validation), least, whole=long)
    starts, notes = context.linear(choices)
    if not any(s.linear.stable for s in starts):
        context = replace(context, must_be_bounded=False)
        starts = [_without_stress(tolerant(s)) for s in starts]
        notes.append(f"{INTEGRATES} Boundedness was not asked for.")
    if context.folds:
        notes.append("Little data: parts of it were held out in turn to choose the number of rules.")
    plain = context.completed(starts[0])
    return Search.begun(context, (train, validation), own, plain, starts, notes)


def _context(
    settings: RuleSettings,
    data: tuple[Dataset, Dataset | None],
    least: int,
    scaled: tuple[FloatArray, FloatArray] | None = None,
    *,
    whole: bool = False,
) -> tuple[SearchContext, bool]:
    """The data split for segments of at least so many rows; whether the judging part is of the training data.

    Parameters
    ----------
    scaled : shift and scale; None: of the fitting part.
    whole : the judging part is whole flights, where there are enough.
    """
    train = data[0]
    fit_part, check_part, own = _parts(*data, least, whole=whole)
    s = settings.search
    small = own and settings.rules == "auto" and settings.refine and len(train) < s.short
    folds = tuple(hold_out(train, least, fold) for fold in range(1, s.folds)) if small else ()
    ridges = s.ridges if settings.ridge == "auto" else (settings.ridge,)
    shift, scale = scaled or scaling(fit_part)
    context = SearchContext(
        settings,
        fit_part,
        check_part,
        shift,
        scale,
        least,
        folds=folds,
        promise=s.rule_gain,
        ridges=ridges,
    )
    return context, own


def _without_stress(family: Family) -> Family:
    def freed(c: Candidate) -> Candidate:
        return replace(c, stage=c.stage.under(stress=None))

    return replace(family, folds=tuple(tuple(map(freed, fold)) for fold in family.folds))


def _deepest(settings: RuleSettings, train: Dataset) -> int:
    """Samples that the linear side's models may look back."""
    longest = max((len(s) for s in train.segments), default=0)
    return min(
        _DEEPEST_DELAY if len(train) > settings.search.short else _HIGHEST_LINEAR, int(START_SHARE * longest)
    )


def _parts(
    train: Dataset, validation: Dataset | None, least: int, *, whole: bool = False
) -> tuple[Dataset, Dataset, bool]:
    longest = max((len(s) for s in train.segments), default=0)
    if longest < least:
        raise DataError(
            f"the longest segment has {longest} samples; this model needs {least}",
            hint="record longer, allow longer gaps, or ask for lower orders or fewer states",
        )
    if validation is not None and any(len(s) >= least for s in validation.segments):
        return train, validation, False
    kept, held = _whole_flights(train, least) if whole else hold_out(train, least)
    return kept, held, True


def _whole_flights(train: Dataset, least: int) -> tuple[Dataset, Dataset]:
    """The parts that the baseline is chosen on, where flights are enough: its rivals share their fits."""
    if len(train.flights) >= MIN_FLIGHTS:
        with suppress(DataError):
            parts = parts_to_choose_on(train)
            if all(any(len(s) >= least for s in part.segments) for part in parts):
                return parts
    return hold_out(train, least)


def state_starts(settings: RuleSettings, train: Dataset, validation: Dataset | None) -> Search:
    """Linear systems, and the data split as they need it."""
    check(settings)
    scaled = scaling(train)
    systems = linear_systems(settings, train, validation, scaled)
    least = max(s.orders.depth for s in systems) + 2 * max(map(len, systems)) + SPARE_ROWS
    ends = saturation_limits(train)
    context, own = _context(settings, (train, validation), least, scaled)
    ridges = context.ridges[1:] or context.ridges
    context = replace(context, promise=CLEARLY, ridges=ridges)

    def judged(system: StateRealisation) -> Family:
        stages = [system_stage(system, fit, least, scaled, ends) for fit, _ in context.parts]
        checks = [check for _, check in context.parts]
        return Family(
            tuple((context.judge(s, c),) for s, c in zip(stages, checks, strict=True)), system=system
        )

    families = sorted(map(judged, systems), key=lambda f: tolerant(f).rmse[0])
    plain = tolerant(families[0])
    most = 2 * settings.search.highest_order
    starts = [f for f in families if f.linear.stage.layout.n <= most][: settings.search.linear_systems]
    tried = "; ".join(dict.fromkeys(s.title for s in systems))
    notes = [f"Tried, in several coordinates: {tried}."] if len(systems) > 1 else []
    return Search.begun(context, (train, validation), own, plain, starts, [*notes, *in_words(ends, train)])
