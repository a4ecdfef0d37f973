"""The HTML report: one self-contained page. `write_report(path, ReportContext(...))`."""

from flysid.validate.diagnose.context import ReportContext, Sweep
from flysid.validate.show.page.page import render, write_report

__all__ = ["ReportContext", "Sweep", "render", "write_report"]
