"""The paper's experiment, run again: its tables beside what can and what cannot be reproduced.

Trained on signal (13), validated on signal (14), T = 0.01 s, 400 s, from rest, without noise as the paper;
then once more with measurement noise, scored against the noise-free truth.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from flysid.dataset import Dataset, FloatArray, Signal
from flysid.ingest.synth.plants import LOOPS as PLANT_LOOPS
from flysid.ingest.synth.plants import paper_experiment
from flysid.model.base import Estimator, Fitted
from flysid.model.shared import sharing
from flysid.progress import part, tell
from flysid.validate.compare.comparison import Comparison
from flysid.validate.compare.metrics import scores
from flysid.validate.compare.models import compare_models
from flysid.validate.paper.printed import LOOPS, PaperLoop

NOISE_M_S = 0.02
DT_S = 0.01
DURATION_S = 400.0


@dataclass(frozen=True)
class LoopResult:
    """One loop, reproduced.

    `models`: label -> model fitted without noise: static_ts_7, static_ts_3, line, arx, dynamic_ts_3.
    `comparison`: the same models on the validation signal, arx as baseline.
    `noisy_rmse`: label -> RMSE in m/s, against the noise-free truth, of models fitted to noisy data.
    """

    paper: PaperLoop
    models: Mapping[str, Fitted]
    scores: Mapping[str, Mapping[str, float | None]]
    comparison: Comparison
    noisy_rmse: Mapping[str, float]

    @property
    def verdict(self) -> str:
        """Of dynamic_ts_3 against arx in free run."""
        return str(self.comparison.entry().pairs["dynamic_ts_3"].verdict)


def reproduce_ardrone_ts() -> list[LoopResult]:
    """Fit and compare all models on the paper's three loops."""
    found = []
    for i, loop in enumerate(LOOPS):
        with part(i / len(LOOPS), (i + 1) / len(LOOPS), channel=loop.name), sharing():
            found.append(_reproduce_loop(loop))
    return found


def _reproduce_loop(loop: PaperLoop) -> LoopResult:
    train, test = (experiment(loop, signal)[0] for signal in ("training", "validation"))
    models: dict[str, Fitted] = {}
    estimators = _estimators()
    for i, (label, estimator) in enumerate(estimators.items()):
        tell("fitting", model=label, share=i / (len(estimators) + 1))
        models[label] = estimator.fit(train)
    comparison = compare_models(models, test, baseline="arx")
    free = {label: from_rest(model, test) for label, model in models.items()}
    tell(f"fitting with {NOISE_M_S} m/s of noise", share=len(estimators) / (len(estimators) + 1))
    return LoopResult(loop, models, free, comparison, _with_noise(loop))


def _estimators() -> dict[str, Estimator]:
    from flysid.model.arx import ARX
    from flysid.model.line import Line
    from flysid.model.static_ts import StaticTS
    from flysid.model.ts import TS

    return {
        "static_ts_7": StaticTS(rules=7),
        "static_ts_3": StaticTS(rules=3),
        "line": Line(),
        "arx": ARX(),
        "dynamic_ts_3": TS(rules=3, states=0),
    }


def draw_figures(results: list[LoopResult], folder: Path) -> list[Path]:
    """The paper's figures 4, 5 and 6, panels a to h, of the static model with seven rules, on signal (14).

    Raises UsageError: matplotlib is not installed. Raises StoreError: a file cannot be written.
    """
    from flysid.model.static_ts import FittedStaticTS
    from flysid.validate.show.rulesfigure import write_rules_figure

    paths = []
    for number, result in enumerate(results, start=4):
        model = result.models["static_ts_7"]
        (test, _) = experiment(result.paper, "validation")
        assert isinstance(model, FittedStaticTS)
        path = folder / f"figure-{number}-{result.paper.name}.pdf"
        paths.append(write_rules_figure(path, model, test.segments[0]))
    return paths


def experiment(
    loop: PaperLoop, signal: str, noise: float = 0.0, *, noise_seed: int = 1
) -> tuple[Dataset, FloatArray]:
    """The dataset of a loop and signal, and the (N,) output without noise."""
    plant = PLANT_LOOPS[loop.name]
    u, y, truth = paper_experiment(
        loop.name, signal, duration_s=DURATION_S, dt_s=DT_S, noise=noise, seed=noise_seed
    )
    data = Dataset.from_arrays(
        u,
        y,
        DT_S,
        inputs=[Signal(loop.input_name, plant.input_unit)],
        outputs=[Signal(loop.output_name, plant.output_unit)],
        name=loop.name,
    )
    return data, truth


def from_rest(model: Fitted, test: Dataset) -> dict[str, float | None]:
    """RMSE in m/s and VAF in per cent of a free run that starts at rest, as the plant does."""
    segment = test.segments[0]
    found = scores(segment.y[:, 0], model.simulate(segment.u)[:, 0])
    return {"rmse": found.rmse, "vaf_pct": found.vaf_pct, "fit_pct": found.fit_pct}


def _with_noise(loop: PaperLoop) -> dict[str, float]:
    from flysid.model.arx import ARX
    from flysid.model.ts import TS

    train, _ = experiment(loop, "training", NOISE_M_S)
    test, truth = experiment(loop, "validation", NOISE_M_S)
    estimators: dict[str, Estimator] = {
        "arx_one_step": ARX(refine=False),
        "arx": ARX(),
        "dynamic_ts_3": TS(rules=3, states=0),
    }
    found = {}
    for label, estimator in estimators.items():
        model = estimator.fit(train)
        found[label] = scores(truth, model.simulate(test.segments[0].u)[:, 0]).rmse
    return found


def to_document(results: list[LoopResult]) -> dict[str, Any]:
    """{"loops": {NAME: {LABEL: {"rmse", "vaf_pct"}, "verdict", "paper", "noise"}}}."""
    return {
        "loops": {
            r.paper.name: {
                **{label: dict(values) for label, values in r.scores.items()},
                "verdict": r.verdict,
                "paper": {
                    "rmse_text": r.paper.rmse_text,
                    "rmse_summary": r.paper.rmse_summary,
                    "vaf_claim_pct": r.paper.vaf_claim_pct,
                },
                "noise": {"sigma_m_s": NOISE_M_S, "rmse_to_truth": dict(r.noisy_rmse)},
            }
            for r in results
        },
        "experiment": {"dt_s": DT_S, "duration_s": DURATION_S, "train": "(13)", "validate": "(14)"},
    }
