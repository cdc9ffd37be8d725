"""Rigid bodies of FEBio as cases: closed forms after import, and what stays an error."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from helpers.deck_cases import last, one
from helpers.decks import box, quadratic
from helpers.febio_text import febio_text

from dolfin_elastic.case.decks.deck import Deck
from dolfin_elastic.case.decks.reading import read_deck
from dolfin_elastic.core.errors import MeshError

LENGTH, E = 8.0, 200.0
POINTS, CELLS = quadratic(*box((LENGTH + 2, 1, 1), (5, 1, 1)))
SOFT = (
    '<material id="1" name="soft" type="isotropic elastic"><density>8</density>'
    f"<E>{E}</E><v>0</v></material>"
)
RIGID = '<material id="2" name="hard" type="rigid body"><density>3</density>{}</material>'
STATIC = (
    "<Control><analysis>STATIC</analysis><time_steps>1</time_steps><step_size>1</step_size>"
    "</Control>"
)
HELD = '<Boundary><bc type="zero displacement" node_set="wall"><x_dof>1</x_dof><y_dof>1</y_dof>'
HELD += "<z_dof>1</z_dof></bc>{}</Boundary>"
JOINED = '<bc type="rigid" node_set="tip"><rb>{}</rb></bc>'
RIGID_PLATE = f"<Material>{SOFT}{RIGID.format('')}</Material>{STATIC}"
CURVE = '<LoadData><load_controller id="1" type="loadcurve"><points><pt>0,0</pt><pt>0.5,2</pt>'
CURVE += "<pt>1,1</pt></points></load_controller></LoadData>"
FREE = '<rigid_bc type="rigid_fixed"><rb>hard</rb><Rx_dof>0</Rx_dof></rigid_bc>'


def read(folder: Path, rigid: str, boundary: str = "", centre: str = "", *, block: bool) -> Deck:
    """A bar along x with a rigid block at its end, or with nodes there that are joined to a body.

    Args:
        rigid: What <Rigid> contains.
        boundary: More in <Boundary>.
        centre: More in the rigid material.
        block: The last two units of length are of the rigid material.
    """
    hard = POINTS[CELLS[:, :4], 0].mean(axis=1) > LENGTH
    ends = {"wall": 0, "tip": LENGTH}
    parts = {"bar": CELLS[~hard]} | ({"block": CELLS[hard]} if block else {})
    more = f"<Material>{SOFT}{RIGID.format(centre)}</Material>{STATIC}{HELD.format(boundary)}"
    text = febio_text(
        POINTS,
        parts,
        sets={name: np.flatnonzero(POINTS[:, 0] == x) for name, x in ends.items()},
        version="4.0",
        more=f"{more}<Rigid>{rigid}</Rigid>{CURVE}",
    )
    domains = '<SolidDomain name="bar" mat="soft"/>'
    domains += '<SolidDomain name="block" mat="hard"/>' if block else ""
    text = text.replace("</Mesh>", f"</Mesh>\n<MeshDomains>{domains}</MeshDomains>")
    (folder / "model.feb").write_text(text)
    return read_deck(folder / "model.feb")


def force(dof: str, value: float, kind: str = "rigid_force") -> str:
    return (
        f'<rigid_load type="{kind}"><rb>2</rb><dof>{dof}</dof><value>{value}</value></rigid_load>'
    )


FIXED = "".join(f"<R{a}_dof>1</R{a}_dof>" for a in "yzuvw")


@pytest.mark.long
def test_a_rigid_block_that_is_pulled(tmp_path: Path) -> None:
    """With nu = 0 the bar has one strain e, and St. Venant and Kirchhoff's law F = E A (1 + e)
    (e + e^2/2); the block moves by e L.  Two forces in a direction add up.
    Without its rigid surface the block would be stretched."""
    e = 0.05
    bc = f'<rigid_bc type="rigid_fixed"><rb>hard</rb>{FIXED}</rigid_bc>'
    pull = E * (1 + e) * (e + e**2 / 2)
    twice = force("Rx", pull / 4) + force("Rx", 3 * pull / 4)
    table = one(read(tmp_path, bc + twice, block=True))
    selectors = [{"between": ["block", "bar"]}, {"of": "block", "all": True}]
    assert table["surfaces"]["hard surface"] == selectors
    assert table["materials"]["hard"]["density"] == "3 kg/m^3"
    (support,) = [s for s in table["support"] if s["kind"] == "rigid"]
    assert support["displacement"] == ["free", 0, 0]
    assert support["rotation"] == [0, 0, 0]
    assert last(table, tmp_path).max_displacement == pytest.approx(e * LENGTH, rel=1e-9)


def test_a_rigid_block_that_is_bent(tmp_path: Path) -> None:
    """A moment on the block, about whose centre of mass it turns by M L / (E I); it moves with the
    bar's end by M L^2 / (2 E I) and by its turn, so that its far corner does by both.  Exact for
    quadratic displacements where the moment is small."""
    M = 1e-4
    table = one(read(tmp_path, FREE + force("Rw", M, "rigid_moment"), block=True))
    (support,) = [s for s in table["support"] if s["kind"] == "rigid"]
    assert support["point"] == pytest.approx([LENGTH + 1, 0.5, 0.5], rel=1e-12)
    turn = 12 * M * LENGTH / E
    corner = math.hypot(turn * LENGTH / 2 + 2 * turn, turn / 2)
    assert last(table, tmp_path).max_displacement == pytest.approx(corner, rel=1e-3)


def test_nodes_joined_to_a_body_that_is_turned(tmp_path: Path) -> None:
    """The end of the bar turns by a prescribed angle about the centre of mass of a body without
    elements, and is prescribed in all directions: its nodes have the motion of a rigid body,
    and those two away from the axis the largest chord."""
    angle, centre = 0.1, [LENGTH, 2.0, 0.5]
    motion = (
        '<rigid_bc type="rigid_fixed"><rb>2</rb><Rx_dof>1</Rx_dof><Ry_dof>1</Ry_dof><Rz_dof>1'
        f'</Rz_dof></rigid_bc><rigid_bc type="rigid_rotation_vector"><rb>2</rb><vz>{angle}</vz>'
        "</rigid_bc>"
    )
    text = f"<center_of_mass>{','.join(map(str, centre))}</center_of_mass>"
    table = one(read(tmp_path, motion, JOINED.format(2), text, block=False))
    (support,) = [s for s in table["support"] if s["kind"] == "rigid"]
    furthest = 2 * 2 * math.sin(angle / 2)
    assert last(table, tmp_path).max_displacement == pytest.approx(furthest, rel=1e-9)
    assert support == {
        "kind": "rigid",
        "on": "tip",
        "point": centre,
        "displacement": [0, 0, 0],
        "rotation": [0, 0, angle],
    }


def test_a_direction_that_is_prescribed_twice(tmp_path: Path) -> None:
    """The later motion took the place of the one before it, in silence; equal ones are one."""
    motion = (
        '<rigid_bc type="rigid_displacement"><rb>hard</rb><dof>x</dof><value>{}</value></rigid_bc>'
    )
    still = '<rigid_bc type="rigid_fixed"><rb>hard</rb><Rx_dof>1</Rx_dof></rigid_bc>'
    for first, second in ((0.1, 0.2), (0.1, 0.1)):
        rigid = motion.format(first) + motion.format(second)
        found = [str(fault) for fault in read(tmp_path, rigid, block=True).faults]
        said = "direction Rx of 'hard' is prescribed twice, in different ways"
        assert [said in text for text in found] == [True] * (first != second)
    (fault,) = read(tmp_path, motion.format(0.1) + still, block=True).faults
    assert "prescribed twice" in str(fault)


def test_rigid_parts_without_tetrahedra(tmp_path: Path) -> None:
    """Of a shell there is no boundary and no centre of mass."""
    text = febio_text(POINTS, {"bar": CELLS}, version="4.0", more=RIGID_PLATE)
    plate = '<Elements type="tri3" name="plate"><elem id="9999">1,2,3</elem></Elements>'
    domains = '<SolidDomain name="bar" mat="soft"/><ShellDomain name="plate" mat="hard"/>'
    text = text.replace("</Mesh>", f"{plate}</Mesh><MeshDomains>{domains}</MeshDomains>")
    (tmp_path / "model.feb").write_text(text)
    faults = read_deck(tmp_path / "model.feb").faults
    assert any("a rigid part without tetrahedra" in str(fault) for fault in faults)


def test_words_of_version_3(tmp_path: Path) -> None:
    """Rx to Rz are displacements, Ru to Rw rotations."""
    words = (
        '<rigid_constraint type="fix"><rb>2</rb><dofs>Rx,Ru,Rv,Rw</dofs></rigid_constraint>'
        '<rigid_constraint type="prescribe"><rb>2</rb><dof>Ry</dof><value>0.5</value>'
        '</rigid_constraint><rigid_constraint type="force"><rb>2</rb><dof>Rz</dof><value>4</value>'
        "</rigid_constraint>"
    )
    table = one(read(tmp_path, words, JOINED.format("hard"), block=False))
    assert table["support"][1] == {
        "kind": "rigid",
        "on": "tip",
        "displacement": [0, "0.5 m", "free"],
        "rotation": [0, 0, 0],
        "force": [0, 0, "4 N"],
    }


def test_a_body_that_is_fixed(tmp_path: Path) -> None:
    """Its nodes are fixed."""
    bc = f'<rigid_bc type="rigid_fixed"><rb>2</rb><Rx_dof>1</Rx_dof>{FIXED}</rigid_bc>'
    table = one(read(tmp_path, bc, JOINED.format("2"), block=False))
    assert table["support"][1] == {"on": "tip", "kind": "fixed"}


OTHERS = {
    '<rigid_bc type="rigid_euler_angles"><rb>2</rb></rigid_bc>': "'rigid_euler_angles' of rigid",
    '<rigid_connector type="rigid spring"/>': "'rigid spring' of rigid bodies",
    force("Rx", 1.0).replace("<dof>", "<load_type>1</load_type><dof>"): "that turns with the body",
    '<rigid_bc type="rigid_displacement"><rb>2</rb><dof>x</dof><value>1</value><relative>1'
    "</relative></rigid_bc>": "a value that is relative",
    force("Rx", 1.0) + force("Rx", 2.0).replace("<value>", '<value lc="1">'): "in different ways",
    force("Rx", 1.0).replace("<rb>2", "<rb>7"): "there is no material '7' of type 'rigid body'",
}


@pytest.mark.parametrize("rigid", OTHERS)
def test_rigid_bodies_that_are_not_there(tmp_path: Path, rigid: str) -> None:
    """Each is an error with its line."""
    (fault,) = read(tmp_path, FREE + rigid, block=True).faults
    assert OTHERS[rigid] in str(fault) and fault.place.line


@pytest.mark.parametrize(("dof", "said"), [("Rq", "'Rq' is no direction"), ("Rw", "no <center_of")])
def test_rigid_bodies_that_cannot_be_read(tmp_path: Path, dof: str, said: str) -> None:
    """One message with the line."""
    rigid = force(dof, 1.0, "rigid_moment")
    with pytest.raises(MeshError, match=rf"model.feb:\d+: .*{said}"):
        read(tmp_path, rigid, JOINED.format(2), block=False)
