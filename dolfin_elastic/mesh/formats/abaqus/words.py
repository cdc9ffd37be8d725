"""Keywords of Abaqus and CalculiX that do not describe a mesh."""

from __future__ import annotations

OF_A_CASE = frozenset(
    (
        *("MATERIAL", "BOUNDARY", "CLOAD", "DLOAD", "DSLOAD", "TEMPERATURE", "CONTACT PAIR"),
        *("TIE", "EQUATION", "MPC", "COUPLING", "RIGID BODY", "SPRING", "DASHPOT", "MASS"),
        *("ELASTIC", "HYPERELASTIC", "PLASTIC", "DENSITY", "EXPANSION", "DAMPING", "ORIENTATION"),
        *("SOLID SECTION", "AMPLITUDE", "INITIAL CONDITIONS", "TRANSFORM", "KINEMATIC"),
        *("DISTRIBUTING", "FREQUENCY", "BUCKLE", "DYNAMIC", "CONTROLS", "SOLVER", "TIME POINTS"),
        *("SURFACE INTERACTION", "SURFACE BEHAVIOR", "FRICTION", "CONTACT"),
    )
)
"""Keywords of the model, no part of the mesh, and reported so that nobody relies on them."""
REFUSED = frozenset(
    (
        *("NMAP", "USER ELEMENT", "PARAMETER", "IMPERFECTION", "SYMMETRIC MODEL GENERATION"),
        *("IMPORT", "SUPERELEMENT", "SUBSTRUCTURE PATH"),
    )
)
"""Keywords that make, move or remove nodes and elements."""
_OF_RESULTS = frozenset(
    (
        *("NODE OUTPUT", "NODE PRINT", "NODE FILE", "NODE RESPONSE", "NODAL ENERGY"),
        *("ELEMENT OUTPUT", "ELEMENT RESPONSE", "ELEMENT MATRIX OUTPUT"),
        *("ELEMENT OPERATOR OUTPUT", "ELEMENT RECOVERY MATRIX", "ELEMENT PROPERTIES"),
        *("EL FILE", "EL PRINT", "CONTACT FILE", "CONTACT OUTPUT", "CONTACT PRINT", "OUTPUT"),
        *("ENERGY FILE", "ENERGY OUTPUT", "ENERGY PRINT", "FILE FORMAT", "FILE OUTPUT"),
        *("MONITOR", "PRINT", "PREPRINT", "RESTART", "SECTION FILE", "SECTION PRINT"),
    )
)
_OF_A_FILE = frozenset(
    ("", "INCLUDE", "HEADING", "STEP", "END STEP", "STATIC", "NO ANALYSIS", "END PART")
)
_OF_ELEMENTS = frozenset(
    ("ADAPTIVE MESH", "EMBEDDED ELEMENT", "NODAL THICKNESS", "REFINE MESH", "CONSTRAINED NODES")
)
"""Keywords of the model that speak of nodes and elements, and change none of the deck's."""
SILENT = _OF_RESULTS | _OF_A_FILE
"""Keywords that are not read, and that a case has no need of."""
_OF_MESHES = frozenset(
    ("NODE", "NODES", "NODAL", "ELEMENT", "ELEMENTS", "MESH", "COORDINATE", "COORDINATES")
)


def speaks_of_the_mesh(keyword: str) -> bool:
    """Whether an unknown keyword may define nodes, elements or coordinates."""
    return keyword not in _OF_ELEMENTS and not _OF_MESHES.isdisjoint(keyword.split())
