"""Which orders of lags to try, and whether what was asked for can be."""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np

from flysid.dataset import Dataset
from flysid.errors import UsageError
from flysid.model.arguments import is_count
from flysid.model.rules.regressor_layout import Antecedent, Orders, check_they_move, parse_antecedents
from flysid.model.rules.search_settings import RuleSettings


def check(settings: RuleSettings) -> None:
    """Raise UsageError for settings that cannot be."""
    settings.search.check()
    for name in ("rules", "states", "na"):
        value = getattr(settings, name)
        low = 1 if name == "rules" else 0
        if value != "auto" and not is_count(value, low):
            raise UsageError(f"{name}={value!r}", hint=f'give "auto" or a whole number from {low} on')
    for name in ("nb", "nk"):
        value = getattr(settings, name)
        numbers = list(value) if isinstance(value, Sequence | np.ndarray) else [value]
        if value != "auto" and not all(is_count(v, 0) for v in numbers):
            raise UsageError(f"{name}={value!r}", hint='give "auto", a whole number, or one per input')
    for name in ("most_rules", "iterations"):
        if not is_count(getattr(settings, name), 1):
            raise UsageError(f"{name}={getattr(settings, name)!r}", hint="give a whole number, at least 1")
    ridge = settings.ridge
    if ridge != "auto" and not (isinstance(ridge, int | float) and 0 <= ridge < np.inf):
        raise UsageError(f"ridge={ridge!r}", hint='give "auto", or 0 or more; 0.01 is usual')
    asked = settings.antecedents
    if asked != "auto" and (isinstance(asked, str) or not asked):
        raise UsageError(f"antecedents={asked!r}", hint='give "auto" or a list of names')
    if not isinstance(settings.refine, bool):
        raise UsageError(f"refine={settings.refine!r}", hint="give True or False")


def _per_input(value: int | Sequence[int], inputs: int, name: str) -> tuple[int, ...]:
    numbers = (int(value),) * inputs if isinstance(value, int | np.integer) else tuple(map(int, value))
    if len(numbers) != inputs:
        raise UsageError(f"{name} has {len(numbers)} numbers for {inputs} inputs")
    return numbers


def order_choices(settings: RuleSettings, inputs: int) -> list[Orders]:
    """Orders to try, simplest first: n outputs and n + 1 inputs from the present one on.

    n goes from 1 to `search.highest_order`; behind a dead time that the log shows there is no present one.

    Raises
    ------
    UsageError : orders that leave nothing to learn, or another number of them than of inputs.
    """
    choices: list[Orders] = []
    own = tuple(settings.nk_least) or (0,) * inputs
    for n in range(1, settings.search.highest_order + 1):
        na = n if settings.na == "auto" else int(settings.na)
        nk = own if settings.nk == "auto" else _per_input(settings.nk, inputs, "nk")
        more = [1 if settings.nk == "auto" and k == 0 else 0 for k in nk]
        lags = n if settings.na == "auto" else na
        nb = [lags + one for one in more] if settings.nb == "auto" else settings.nb
        orders = Orders(na, _per_input(nb, inputs, "nb"), nk)
        if orders not in choices:
            choices.append(orders)
    if all(b == 0 for b in choices[0].nb) and choices[0].na == 0:
        raise UsageError("na = 0 and nb = 0 leave nothing to learn")
    return sorted([*choices, *_delay(settings, choices)], key=lambda o: (o.na, sum(o.nb)))


def _delay(settings: RuleSettings, choices: Sequence[Orders]) -> list[Orders]:
    """The choices behind the dead times that the log shows, where no choice bridges those by itself."""
    hint = tuple(settings.nk_hint)
    if settings.nk != "auto" or max(hint, default=0) <= 1:  # as late as any plant behind a hold
        return []
    own = choices[0].nk
    hint = tuple(map(max, hint, own))
    # the coefficient of the present input goes
    fewer = [1 if settings.nb == "auto" and k == 0 else 0 for k in own]
    behind = [
        Orders(o.na, tuple(max(1, b - f) for b, f in zip(o.nb, fewer, strict=True)), hint) for o in choices
    ]
    return [orders for orders in behind if orders not in choices]


def named_antecedents(
    settings: RuleSettings, choices: Sequence[Orders], train: Dataset
) -> tuple[Antecedent, ...]:
    """The antecedents asked for, at the lags that they have with any of these orders."""
    if settings.antecedents == "auto":
        return ()
    found = (
        parse_antecedents(settings.antecedents, train.outputs, train.inputs, orders.nk) for orders in choices
    )
    named = tuple(dict.fromkeys(itertools.chain.from_iterable(found)))
    check_they_move(named, train)
    return named
