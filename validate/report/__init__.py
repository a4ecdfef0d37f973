"""The HTML report: one self-contained page. `write_report(path, ReportContext(...))`."""

from flysid.validate.report.context import ReportContext, Sweep
from flysid.validate.report.page import render, write_report

__all__ = ["ReportContext", "Sweep", "render", "write_report"]
