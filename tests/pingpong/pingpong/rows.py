"""What flysid's tables get from this package."""

from __future__ import annotations

import numpy as np

from flysid.cli.verbs import Verb
from flysid.model.structures import Structure
from flysid.validate.show.page.channel_data import Source
from flysid.validate.show.page.modelpanels import Figure, Panel
from flysid.validate.show.page.svg import Axes, frame, line, picture

BOUNCE = Structure(
    "bounce",
    "pingpong.bounce:from_dict",
    estimator="pingpong.bounce:Bounce",
    takes=("seed",),
    kind="other",
    words="ball on a jet",
)
REFEREE = Verb("referee", "Count the bounces in a log.", command="pingpong.referee:command")


def bounces(source: Source, output: int, signal: int) -> list[Panel]:  # noqa: ARG001
    """The measured output of the first held-out segment, once more."""
    y = source.comparison.test.segments[0].y[:, output]
    axes = Axes((0.0, float(len(y))), (float(y.min()), float(y.max()) + 1e-9))
    parts = [frame(axes, "height", "sample"), line(axes, np.arange(len(y), dtype=np.float64), y, "measured")]
    return [
        Panel("Bounces", "what the ball did", picture(axes.right + 20, axes.bottom + 40, parts, "Bounces"))
    ]


BOUNCES = Figure("bounces", "data", bounces)
