"""The report of a capture: ``report.json`` holds every fact, ``report.html`` shows them."""

from gpusim.report.facts import facts
from gpusim.report.page import page

__all__ = ["facts", "page"]
