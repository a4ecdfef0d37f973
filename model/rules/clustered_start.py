"""A dynamic TS model as the literature makes it: product-space clusters and one-step least squares.

Babuska, Fuzzy Modeling for Control (1998): clusters of antecedents and outputs give the memberships, eq. (4)
of the paper the consequents. Cheap, and good one step ahead; in free run it is where
refinement on the simulation error begins, not where it ends. `TS(refine=False)` stops here.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from flysid.model.rules.clustering import cluster, project
from flysid.model.rules.free_run_error import Body
from flysid.model.rules.growth import unrefined
from flysid.model.rules.memberships import Partition
from flysid.model.rules.regressor_layout import Antecedent
from flysid.model.rules.stages import Stage


def clustered_stage(linear: Stage, antecedents: tuple[Antecedent, ...], rules: int) -> Stage:
    """`rules` rules from Gustafson-Kessel clusters, consequents by global one-step least squares.

    Raises
    ------
    DataError : fewer distinct samples than rules.
    """
    if rules == 1:
        return linear
    layout = replace(linear.problem.layout, antecedents=antecedents)
    problem = linear.problem.with_antecedents(layout)
    d = layout.depth
    n_y = layout.n_y
    z = np.vstack([layout.antecedent_values(W) for W in problem.runs])
    Y = np.vstack([W[d:, :n_y] for W in problem.runs])
    centre, width, _ = project(cluster(np.hstack([z, Y]), rules), z.shape[1], two_sided=False)
    low, high = problem.z_range
    phi = Partition(centre, width, width, low, high).firing(z)
    E = np.vstack([layout.regressor_values(W) for W in problem.runs]) @ problem.basis.T
    design = (phi[:, :, None] * E[:, None, :]).reshape(len(E), -1)
    solution = np.linalg.lstsq(design, Y, rcond=1e-10)[0].reshape(rules, E.shape[1], n_y)
    a = np.ascontiguousarray(solution.transpose(0, 2, 1))
    return unrefined(replace(problem, offset=np.zeros_like(problem.offset)), Body(a, centre, width))
