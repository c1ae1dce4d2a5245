"""The report of a capture: ``report.json`` holds every fact, ``report.html`` shows them."""

from gpusim.report.facts import facts
from gpusim.report.page import page
from gpusim.report.patches import patch_facts

__all__ = ["facts", "page", "patch_facts"]
