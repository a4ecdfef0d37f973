"""Terms that the data do not need, dropped one by one (Tischler & Remple, 2012, 12.3 and 13.3).

Of the terms whose values chance alone could bring, the least sensitive is dropped first, and everything is
fitted anew. A drop stands where the cost rises by no more than chance makes it: for a superfluous term the
rise is, to second order, its squared value over the variance that the cost itself takes it to have, and that
value scatters with the true variance. At a level of 5 % over all terms together (Bonferroni), so that a
superfluous term stays in at most one fit in twenty, however many there are.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

from flysid.errors import FitError
from flysid.model.structured.joint_fit import JointFit, JointProblem


@dataclass(frozen=True)
class Dropped:
    """A term that went, and by how much the cost J rose; 0 where no response shows the term."""

    name: str
    rise: float
    why: str


def without_superfluous(
    problem: JointProblem, fit: JointFit, *, level: float = 0.05
) -> tuple[JointFit, tuple[Dropped, ...]]:
    """The fit with as few terms as the responses need, and those that went."""
    from scipy.special import fdtri

    terms = problem.layout.terms
    dropped: list[Dropped] = []
    tests = len(fit.free)
    while len(fit.free) > 1:
        noise = float(fdtri(1.0, fit.freedom, 1.0 - level / tests))
        doubtful = [k for k in fit.free if fit.theta[k] ** 2 <= noise * fit.covariance[k, k]]
        doubtful.sort(key=partial(_sensitivity, fit))
        for k in doubtful:
            less = _without(problem, fit, k)
            if less is None or less.total - fit.total > noise * fit.price[k]:
                continue
            rise = less.total - fit.total
            dropped.append(
                Dropped(
                    terms[k].name, rise, f"J rises by {rise:.2g}, by chance up to {noise * fit.price[k]:.2g}"
                )
            )
            fit = less
            break
        else:
            break
    return fit, tuple(dropped)


def _sensitivity(fit: JointFit, index: int) -> float:
    """How large a term is beside what it would scatter by if all others were known."""
    return float(abs(fit.theta[index]) / max(float(fit.insensitivity[index]), 1e-300))


def _without(problem: JointProblem, fit: JointFit, index: int) -> JointFit | None:
    """The fit without one term; None where nothing fits without it."""
    try:
        return problem.fit(fit.theta, [k for k in fit.free if k != index])
    except FitError:  # a measured response would have no answer at all
        return None
