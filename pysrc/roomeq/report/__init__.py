"""The report of a run: one HTML page."""

from roomeq.report.step import make_report

__all__ = ["make_report"]
