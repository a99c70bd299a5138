"""The report of a run: one HTML page."""

from roomeq.report.build_page import make_report

__all__ = ["make_report"]
