"""One page of trial flights: a table and a picture an axis, and what was drawn; in the report's style."""

from __future__ import annotations

from importlib import resources
from typing import Any

import numpy as np
from markupsafe import Markup

from flysid.design.campaign import BETTER, Campaign
from flysid.design.designed import SAID
from flysid.design.firmware import SAFETY
from flysid.validate.show.page.html import environment, load_asset
from flysid.validate.show.page.svg import Axes, frame, legend, line, picture, segment
from flysid.version import __version__

UNITS = {"delay_s": "s", "wind_m_s": "m/s", "position_noise_m": "m", "velocity_noise_m_s": "m/s"}


def trial_page(campaign: Campaign, title: str) -> str:
    """The page as HTML that loads nothing."""
    template = (resources.files("flysid.design") / "templates" / "trials.html.j2").read_text("utf-8")
    return (
        environment()
        .from_string(template)
        .render(
            title=title,
            styles=Markup(load_asset("page.css")),
            campaign=campaign,
            said=SAID,
            tables={axis: campaign.table(axis) for axis in campaign.rows},
            pictures={axis: _ratios(campaign, axis) for axis in campaign.rows if "present" in campaign.flown},
            drawn=_drawn(campaign),
            safety=SAFETY,
            version=__version__,
        )
    )


def _ratios(campaign: Campaign, axis: str) -> Markup:
    """Share of trials below a ratio of ISE to that of the present gains, law by law."""
    others = [law for law in campaign.flown if law != "present"]
    axes = Axes((0.0, 100.0), (0.0, 1.5), left=44.0, top=34.0, width=560.0, height=170.0)
    parts = [frame(axes, "squared error over that with your gains", "share of the vehicles, %")]
    parts += [
        segment(axes.left, float(axes.py(v)), axes.right, float(axes.py(v)), "zero") for v in (BETTER, 1.0)
    ]
    for law in others:
        ratios = campaign.ratios(law, axis)
        share = 100.0 * (np.arange(len(ratios)) + 0.5) / len(ratios)
        parts.append(line(axes, share, ratios, f"law {law}"))
    parts.append(legend([(f"law {law}", SAID[law]) for law in others], axes.left, 14.0))
    return picture(620.0, 250.0, parts, f"{axis}: squared error beside the present gains")


def _drawn(campaign: Campaign) -> list[tuple[str, str]]:
    told: list[tuple[str, str]] = []
    for name, value in campaign.drawn.items():
        unit = UNITS.get(name, "times nominal")
        words: Any = f"{value[0]:g} to {value[1]:g}" if isinstance(value, tuple) else f"{value:g}"
        told.append(
            (
                name.removesuffix("_m_s").removesuffix("_s").removesuffix("_m").replace("_", " "),
                f"{words} {unit}",
            )
        )
    return told
