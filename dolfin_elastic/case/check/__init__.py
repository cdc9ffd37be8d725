"""Checks and estimates of a case before anything is compiled or solved."""

from dolfin_elastic.case.check.consistency import check
from dolfin_elastic.case.check.report import Report, report
from dolfin_elastic.case.check.sizes import PartSize

__all__ = ["PartSize", "Report", "check", "report"]
