"""A model of rules as what a state feedback around a position acts on; every state is measured or was sent.

    xi(k) = [v(k) ... v(k - n_v + 1), u(k-1) ... u(k - n_s), p(k), s(k)]

v the channel's velocity, u its input, p the position less its reference, s the sum of p over time. Rule r:
xi(k+1) = F_r xi(k) + G_r u(k), without the rule's constant, which s makes up for. An input that the model
lets act at once, which no sampled loop can use, acts a sample later.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from flysid.compiling import njit
from flysid.dataset import FloatArray
from flysid.design.law import ComplexArray
from flysid.errors import DataError
from flysid.export.lpv import to_lpv
from flysid.model.base import Fitted
from flysid.model.capabilities import HasRuleRecursion, LocallyLinear


@dataclass(frozen=True, eq=False)
class RulePlant:
    """Rules about a position.

    `a`, `b`: (R, n, n), (R, n).
    `speeds`, `sent`: n_v, n_s.
    `scheduling`: (n_z, n) of xi to the antecedents.
    `centre`, `width`: (R, n_z) of Gaussian memberships; `low`, `high`: (n_z,) ends of the antecedents.
    """

    dt_s: float
    a: FloatArray
    b: FloatArray
    speeds: int
    sent: int
    scheduling: FloatArray
    centre: FloatArray
    width: FloatArray
    low: FloatArray
    high: FloatArray

    @property
    def order(self) -> int:
        """n."""
        return len(self.a[0])


@dataclass(frozen=True, eq=False)
class RuleLaw:
    """u = - sum_r w_r K_r xi: parallel distributed compensation (Wang, Tanaka and Griffin, 1996).

    `gains`: (R, n) K.
    `metric`: (n, n) P of the certificate.
    `decay`: g of the certificate, per step.
    `reach_m`: an error of position up to this keeps the input inside its limit, as far as P tells.
    """

    plant: RulePlant
    gains: FloatArray
    metric: FloatArray
    decay: float
    reach_m: float

    def paths(self, omega: FloatArray) -> tuple[ComplexArray, ComplexArray]:
        """(R, F) of velocity and of position (its sum with it) to the input, sign turned: u = - (...)."""
        p = self.plant
        z = np.exp(1j * omega * p.dt_s)
        back = z[None] ** -np.arange(max(p.speeds, p.sent + 1))[:, None]
        seen = self.gains[:, : p.speeds] @ back[: p.speeds]
        own = 1.0 + self.gains[:, p.speeds : p.speeds + p.sent] @ back[1 : p.sent + 1]
        place = self.gains[:, [-2]] + self.gains[:, [-1]] * p.dt_s / (z - 1.0)
        return np.asarray(seen / own), np.asarray(place / own)

    def is_stable_itself(self) -> bool:
        """Whether every rule's controller, which hears its own output, is stable without the vehicle."""
        p = self.plant
        taps = self.gains[:, p.speeds : p.speeds + p.sent]
        return all(bool((np.abs(np.roots([1.0, *row])) < 1.0).all()) for row in taps)


def rule_plant(model: Fitted) -> RulePlant:
    """The plant of a model of rules over lags. Raises DataError: no rules, or over hidden states."""
    hidden = isinstance(model, HasRuleRecursion) and model.layout.hidden
    if not isinstance(model, LocallyLinear) or hidden:
        raise DataError(
            f"{model.structure} has no rules over what is measured",
            hint="fit TS over lags: flysid fit ... --models ts_lags",
        )
    rules = model.local_polynomials()
    at_once = any(np.abs(B[0]).max() > 0.0 for _, B, _ in rules)
    lpv = to_lpv(model)
    m = lpv.memberships
    if m is None or m.shape != "gaussian" or m.conjunction != "product":
        raise DataError("there is one rule: a linear model", hint="--method pid")
    source = model.inputs[0].name
    speeds = len(rules[0][0])
    sent = max(len(rules[0][1]) - 2 + at_once, 1)  # the last input: its changes cost
    n = speeds + sent + 2
    a = np.zeros((len(rules), n, n))
    b = np.zeros((len(rules), n))
    for r, (A, B, _) in enumerate(rules):
        taps = np.concatenate([np.zeros(int(at_once)), B[:, 0, 0]])
        a[r, 0, :speeds] = A[:, 0, 0]
        a[r, 0, speeds : speeds + len(taps) - 2] = taps[2:]
        b[r, 0] = taps[1] if len(taps) > 1 else 0.0
        a[r, 1:speeds, : speeds - 1] = np.eye(speeds - 1)
        b[r, speeds] = 1.0
        a[r, speeds + 1 : speeds + sent, speeds : speeds + sent - 1] = np.eye(sent - 1)
        a[r, n - 2] = 0.5 * model.dt_s * a[r, 0]
        a[r, n - 2, 0] += 0.5 * model.dt_s
        a[r, n - 2, n - 2] = 1.0
        b[r, n - 2] = 0.5 * model.dt_s * b[r, 0]
        a[r, n - 1, n - 1] = 1.0
        a[r, n - 1, n - 2] = model.dt_s
    scheduling = np.zeros((len(lpv.P), n))
    for i, (name, lag, _) in enumerate(lpv.states):
        place = lag - 1 if name != source else speeds + max(lag - 2, 0)
        scheduling[:, place] += lpv.P[:, i]
    if lpv.Q.any():
        scheduling[:, speeds] += lpv.Q[:, 0]
    return RulePlant(model.dt_s, a, b, speeds, sent, scheduling, m.centre, m.left, m.low, m.high)


Packed = tuple[npt.NDArray[np.int64], FloatArray, FloatArray]


def packed_rules(laws: Sequence[RuleLaw | None], *, far: float = 1e6) -> Packed:
    """Several laws for compiled code, padded to one size; no states where there is no law.

    Returns
    -------
    counts : (L, 2) speeds and sent.
    numbers : (L, 2, most, n) gains by rule, and scheduling by antecedent.
    sets : (L, 4, R, n_z) centres, widths, and both ends of the antecedents; a rule too many is far away.
    """
    there = [law for law in laws if law is not None]
    n = max((law.plant.order for law in there), default=1)
    rules = max((len(law.gains) for law in there), default=1)
    n_z = max((len(law.plant.scheduling) for law in there), default=1)
    counts = np.zeros((len(laws), 2), dtype=np.int64)
    numbers = np.zeros((len(laws), 2, max(rules, n_z), n))
    sets = np.zeros((len(laws), 4, rules, n_z))
    sets[:, 0] = far
    sets[:, 1] = 1.0
    for at, law in enumerate(laws):
        if law is None:
            continue
        p = law.plant
        own = len(law.gains), len(p.scheduling)
        counts[at] = p.speeds, p.sent
        numbers[at, 0, : own[0], : p.order] = law.gains
        numbers[at, 1, : own[1], : p.order] = p.scheduling
        sets[at, 0, : own[0]] = 0.0
        sets[at, 0, : own[0], : own[1]] = p.centre
        sets[at, 1, : own[0], : own[1]] = p.width
        sets[at, 2, :, : own[1]] = p.low
        sets[at, 3, :, : own[1]] = p.high
    return counts, numbers, sets


@njit(cache=True)
def blend(xi, numbers, sets):  # type: ignore[no-untyped-def]
    """The input at a state, of one law as `packed_rules` makes it."""
    _, rules, n_z = sets.shape
    grades = np.zeros(rules)
    for i in range(n_z):
        z = 0.0
        for j in range(len(xi)):
            z += numbers[1, i, j] * xi[j]
        z = min(max(z, sets[2, 0, i]), sets[3, 0, i])
        for r in range(rules):
            d = (z - sets[0, r, i]) / sets[1, r, i]
            grades[r] -= 0.5 * d * d
    top = grades.max()
    total = 0.0
    u = 0.0
    for r in range(rules):
        w = np.exp(grades[r] - top)
        total += w
        for j in range(len(xi)):
            u -= w * numbers[0, r, j] * xi[j]
    return u / total
