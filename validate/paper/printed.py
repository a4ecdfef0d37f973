"""What the paper prints, as data: its rule tables, figures of merit and claims.

The paper identifies Takagi-Sugeno fuzzy models of the AR.Drone's inner loops (10)-(12); these are its
tables 1 to 6 and the figures of merit of section 4. "1.0 · 10e-1" there means 0.1. Table 4 lost lines in
print: five of its seven centres are missing (None here). Widths of the memberships are not printed.
"""

from __future__ import annotations

from dataclasses import dataclass

from flysid.model.rule_tables import Row


@dataclass(frozen=True)
class PaperRule:
    """If u is A_i then y = gain u + offset; `centre` of A_i, None where the table lost it."""

    gain: float
    offset: float
    centre: float | None


@dataclass(frozen=True)
class PaperLoop:
    """One loop of the paper.

    `equation`: number of its transfer function.
    `rmse_text`, `rmse_summary`: m/s, as section 4's text and its summary print them (they differ).
    `vaf_claim_pct`: the summary claims more than this for all three loops.
    `rules`: tables 1 and 2, 3 and 4, or 5 and 6.
    """

    name: str
    equation: str
    input_name: str
    output_name: str
    rmse_text: float
    rmse_summary: float
    rules: tuple[PaperRule, ...]
    tables: str
    vaf_claim_pct: float = 95.0

    @property
    def table(self) -> tuple[Row, ...]:
        """The rules as rows of the tables."""
        return tuple(Row((r.gain,), r.offset, None if r.centre is None else (r.centre,)) for r in self.rules)


def _rules(*rows: tuple[float, float, float | None]) -> tuple[PaperRule, ...]:
    return tuple(PaperRule(*row) for row in rows)


LOOPS: tuple[PaperLoop, ...] = (
    PaperLoop(
        "longitudinal",
        "(10)",
        "theta_in",
        "v_x",
        0.028,
        0.029,
        _rules(
            (0.10, -0.022, -2.9),
            (0.097, -0.011, -0.51),
            (0.28, 0.074, 0.063),
            (-0.081, -0.063, 0.19),
            (0.17, -0.033, 0.62),
            (0.026, 0.15, 2.2),
            (0.025, 0.37, 3.7),
        ),
        "tables 1 and 2",
    ),
    PaperLoop(
        "lateral",
        "(11)",
        "phi_in",
        "v_y",
        0.134,
        0.124,
        _rules(
            (0.29, 0.052, -2.6),
            (-0.094, -0.54, -1.7),
            (-0.42, -0.29, None),
            (-0.83, 0.42, None),
            (0.60, 0.15, None),
            (1.4, -1.5, None),
            (1.2, -5.7, None),
        ),
        "tables 3 and 4",
    ),
    PaperLoop(
        "vertical",
        "(12)",
        "vz_in",
        "v_z",
        0.063,
        0.064,
        _rules(
            (0.58, -0.042, -1.9),
            (0.64, 0.027, -0.92),
            (1.1, 0.32, -0.16),
            (0.29, -0.30, -0.012),
            (-0.39, 0.48, 0.47),
            (-1.0, 1.4, 1.0),
            (-0.33, 2.5, 1.9),
        ),
        "tables 5 and 6",
    ),
)

CANNOT_REPRODUCE: tuple[str, ...] = (
    "The paper prints no widths of its membership functions, so its models cannot be rebuilt from its "
    "tables; flysid clusters the same signals and prints its own rules beside the paper's consequents.",
    "Table 4 (lateral loop) is incomplete: five of its seven centres were lost in print.",
    "The horizon is ambiguous. The figures count 400 samples; at T = 0.01 s that is 4 s, in which the "
    "training signal (13) stays positive, while the printed centres reach -2.9. flysid takes 400 s "
    "(40,000 samples).",
    "The summary's claim of more than 95 % of variance for all three loops does not hold for the lateral "
    "loop: no memoryless map of phi_in explains more than about 84 % of v_y there.",
)
