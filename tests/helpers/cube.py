"""The smallest case: a cube of six tetrahedra, fixed on the left and pulled on the right."""

from __future__ import annotations


def cube(law: str = "linear-elastic", *, traction: float = 1, more: str = "") -> str:
    """Text of its case file.

    Args:
        law: Of its material.
        traction: Along x [Pa].
        more: Further keys of the material.
    """
    return f"""\
[mesh]
box = {{size = [1, 1, 1], cells = [1, 1, 1]}}
degree = 1
[materials.m]
law = "{law}"
E = 1e6
nu = 0.3
{more}
[[support]]
on = "left"
[[load]]
kind = "traction"
on = "right"
value = [{traction}, 0, 0]
"""
