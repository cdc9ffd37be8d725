"""Elements of Nastran: their nodes, and which entries are no elements of a body."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Kind:
    """An element.

    Attributes:
        linear: Its kind in the words of meshio with corners only, and how many these are.
        quadratic: The same with all nodes; None: there is no such.
        first: Index of its first node among the fields of the entry.
        order: Places of corners and then of midside nodes among the nodes of a quadratic one.
        part: The field behind its number is that of its property.
    """

    linear: tuple[str, int]
    quadratic: tuple[str, int] | None = None
    first: int = 2
    order: tuple[int, ...] | None = None
    part: bool = True


_TRIANGLE, _QUAD = ("triangle", 3), ("quad", 4)
_SIX, _EIGHT, _LINE = ("triangle6", 6), ("quad8", 8), ("line", 2)

KINDS = {
    "CTETRA": Kind(("tetra", 4), ("tetra10", 10)),
    "CPYRAM": Kind(("pyramid", 5), ("pyramid13", 13)),
    "CPYRA": Kind(("pyramid", 5), ("pyramid13", 13)),
    "CPENTA": Kind(("wedge", 6), ("wedge15", 15)),
    "CHEXA": Kind(("hexahedron", 8), ("hexahedron20", 20)),
    **dict.fromkeys(("CTRIA3", "CTRIAR", "CPLSTN3", "CPLSTS3", "CTRAX3"), Kind(_TRIANGLE)),
    **dict.fromkeys(("CTRIA6", "CPLSTN6", "CPLSTS6", "CTRIAX"), Kind(_TRIANGLE, _SIX)),
    "CTRAX6": Kind(_TRIANGLE, _SIX),
    "CTRIAX6": Kind(_SIX, order=(0, 2, 4, 1, 3, 5)),
    **dict.fromkeys(("CQUAD4", "CQUADR", "CSHEAR", "CPLSTN4", "CPLSTS4", "CQUADX4"), Kind(_QUAD)),
    **dict.fromkeys(("CQUAD8", "CPLSTN8", "CPLSTS8", "CQUADX8"), Kind(_QUAD, _EIGHT)),
    **dict.fromkeys(("CQUAD", "CQUADX"), Kind(_QUAD, ("quad9", 9))),
    **dict.fromkeys(("CROD", "CTUBE", "CBAR", "CBEAM", "CBEND", "CVISC"), Kind(_LINE)),
    "CONROD": Kind(_LINE, first=1, part=False),
    "PLOTEL": Kind(_LINE, first=1, part=False),
}
"""Name of an entry to its nodes."""

OTHERS = frozenset(
    (
        *("CBUSH", "CBUSH1D", "CBUSH2D", "CGAP", "CELAS1", "CELAS2", "CELAS3", "CELAS4", "CWELD"),
        *("CDAMP1", "CDAMP2", "CDAMP3", "CDAMP4", "CDAMP5", "CMASS1", "CMASS2", "CMASS3", "CMASS4"),
        *("CONM1", "CONM2", "CFAST", "CSEAM", "RBE1", "RBE2", "RBE3", "RBAR", "RBAR1", "RROD"),
        *("RSPLINE", "RSSCON", "RTRPLT", "RJOINT", "MPC", "MPCADD", "CHBDYE", "CHBDYG", "CHBDYP"),
        *("CAABSF", "CHACAB", "CHACBR"),
    )
)
"""Springs, masses, joints, rigid connections, absorbers of sound: not read, and reported so that
nobody relies on them."""

NO_ELEMENTS = frozenset(
    (
        *("CONV", "CONVM", "CREEP", "CBARAO"),
        *("CYAX", "CYJOIN", "CYSUP", "CYSYM", "CSET", "CSET1", "CSUPEXT", "CLOAD", "CSSCHD"),
        *("CONTACT", "CONTRLT", "COMBWLD", "CONTINI"),
    )
)
"""Other entries that begin with C, as panels of air do (CAERO1 ...)."""

_OF_A_CASE = (
    *("SPC", "FORCE", "MOMENT", "PLOAD", "GRAV", "ACCEL", "RFORCE", "LOAD", "TEMP", "DLOAD"),
    *("RLOAD", "TLOAD", "LSEQ", "DAREA", "SLOAD", "DEFORM", "SUPORT", "ASET", "BSET", "QSET"),
    *("OMIT", "USET", "SESET", "SET1", "SET2", "SET3", "SET4", "BSURF", "BCONP", "BCTSET"),
    *("BCTABLE", "BCONTACT", "BCBODY", "BLSEG", "BGSET", "SPOINT", "EPOINT", "DMIG", "GENEL"),
)
"""How supports, loads, sets, contacts, and matrices and unknowns beside the mesh begin."""

USUAL = ("MAT", "P", "EIG")
"""How materials, properties, parameters and settings of modes begin, which each case has."""

SOLIDS = ("tetra", "tetra10", "triangle", "triangle6")
"""Elements that a body may consist of."""

_NODES = ("GRIDB", "GRIDF", "GRIDS", "GRIDA", "EGRID", "RINGAX", "SECTAX", "RINGFL")


def is_of_a_case(name: str) -> bool:
    """Whether an entry is to be said in the case file."""
    return name in OTHERS or name.startswith(_OF_A_CASE)


def misunderstood(name: str) -> str:
    """What an entry would define of the mesh that is not read; empty: nothing.

    Args:
        name: Of an entry that is not read.
    """
    if name.startswith("CORD"):
        return "this kind of coordinate system"
    if name.startswith("GRID") or name in _NODES:
        return "this kind of node"
    if name in ("CSUPER", "SEBULK", "SELOC", "SEMPLN", "SETREE"):
        return "a superelement"
    if name.startswith("C") and name not in NO_ELEMENTS and not name.startswith("CAERO"):
        return "this element"
    return ""
