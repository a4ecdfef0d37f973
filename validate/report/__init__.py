"""The former place of the page, which is `flysid.validate.show.page`.

Packages that add figures to the page (entry point `flysid.figures`) import these modules from here still.
"""

import importlib
import sys
import warnings

from flysid.validate.show.page import ReportContext as ReportContext
from flysid.validate.show.page import Sweep as Sweep
from flysid.validate.show.page import render as render
from flysid.validate.show.page import write_report as write_report

for _name in ("channel_data", "modelpanels", "svg"):
    sys.modules[f"{__name__}.{_name}"] = importlib.import_module(f"flysid.validate.show.page.{_name}")
warnings.warn("flysid.validate.report is flysid.validate.show.page", FutureWarning, stacklevel=2)
