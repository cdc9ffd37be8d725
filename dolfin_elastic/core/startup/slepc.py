"""SLEPc, which is imported from here alone: slepc4py looks for slepc.cfg in the current folder."""

from __future__ import annotations

from dolfin_elastic.core.startup.elsewhere import elsewhere

with elsewhere():
    from slepc4py import SLEPc

__all__ = ["SLEPc"]
