"""Case files: what is read, written back, checked, and the message about every mistake."""

from __future__ import annotations

import pickle
import tomllib
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest
from mpi4py import MPI

from dolfin_elastic.case.case import Case
from dolfin_elastic.case.check.consistency import check
from dolfin_elastic.case.check.report import report
from dolfin_elastic.case.check.rest import read_case
from dolfin_elastic.case.run import run
from dolfin_elastic.cli.tools.files import Kind, template
from dolfin_elastic.core.errors import InputError
from dolfin_elastic.core.parallel import on_root
from dolfin_elastic.model.loads import LOADS
from dolfin_elastic.model.materials.registry import MATERIALS
from dolfin_elastic.solvers.diagnostics.rigid_body import free_motions

COMM = MPI.COMM_WORLD
GOOD = """\
title = "Block"
[mesh]
box = {size = [2, 1, 1], cells = [2, 1, 1]}
unit = "mm"
degree = 1
[surfaces]
foot = {plane = "z", at = "min"}
[regions]
core = {box = [[0, 0, 0], ["1 mm", 1, 1]]}
[materials.steel]
law = "linear-elastic"
E = "210 GPa"
nu = 0.3
[[support]]
on = "left"
displacement = [0, 0, 0]
[[load]]
kind = "traction"
on = "right"
value = [0, 0, "1 MPa"]
[statics]
steps = 2
[solver]
method = "direct"
[output]
fields = ["displacement"]
"""


def case_of(folder: Path, text: str) -> Case:
    """Writes a case file on one rank and reads it on all. Collective."""
    if COMM.rank == 0:
        (folder / "case.toml").write_bytes(text.encode("utf-8", "surrogateescape"))
    return read_case(folder / "case.toml")


def message_of(folder: Path, text: str) -> str:
    """What a check says about a case that is wrong, the same on every rank. Collective."""
    with pytest.raises(InputError) as caught:
        report(case_of(folder, text))
    messages = COMM.allgather(str(caught.value).replace(f"{folder}/", ""))
    assert len(set(messages)) == 1
    assert caught.value.exit_code == 2
    assert not list(folder.glob("*_results"))
    return messages[0]


# Text to replace, its replacement, and the message about it.
MISTAKES = {
    "table": ("[solver]", "[sovler]", "unknown key 'sovler'; did you mean 'solver'?"),
    "key": ("unit =", "units =", "mesh: unknown key 'units'; did you mean 'unit'?"),
    "selector key": (
        "plane =",
        "plain =",
        "surfaces.foot: unknown key 'plain'; did you mean 'plane'?",
    ),
    "law const": (
        "nu = 0.3",
        "nuu = 0.3",
        "materials.steel: unknown key 'nuu'; did you mean 'nu'?",
    ),
    "settings key": ("steps = 2", "step = 2", "statics: unknown key 'step'; did you mean 'steps'?"),
    "load key": ("value = [", "vaule = [", "load[0]: unknown key 'vaule'; did you mean 'value'?"),
    "support key": (
        "displacement = [",
        "dispacement = [",
        "support[0]: unknown key 'dispacement'; did you mean 'displacement'?",
    ),
    "output key": ("fields =", "field =", "output: unknown key 'field'; did you mean 'fields'?"),
    "key of one table or a list of them": (
        "[output]",
        "[output]\npictures = [{file = 'a.png', clip = {normal = [0, 1, 0]}}]",
        "output.pictures[0].clip: unknown key 'normal'; known: at, keep, plane",
    ),
    "law": (
        '"linear-elastic"',
        '"linear-elastik"',
        "materials.steel.law: unknown law 'linear-elastik'; did you mean 'linear-elastic'?",
    ),
    "law missing": (
        'law = "linear-elastic"\n',
        "",
        f"materials.steel.law: this key is missing; known: {', '.join(MATERIALS)}; or write "
        'material = "steel S235" for one of the library',
    ),
    "kind": (
        '"traction"',
        '"tracktion"',
        "load[0].kind: unknown kind 'tracktion'; did you mean 'traction'? known: "
        f"{', '.join(LOADS)}",
    ),
    "kind in words": (
        '"traction"',
        '"Force"',
        "load[0].kind: unknown kind 'Force'; did you mean 'force'? known: force, "
        f"{', '.join(kind for kind in LOADS if kind != 'force')}",
    ),
    "kind unlike any": (
        '"traction"',
        '"wind"',
        f"load[0].kind: unknown kind 'wind'; known: {', '.join(LOADS)}",
    ),
    "kind missing": (
        'kind = "traction"\n',
        "",
        f"load[0].kind: this key is missing; known: {', '.join(LOADS)}",
    ),
    "unit of E": (
        '"210 GPa"',
        '"210 mm"',
        "materials.steel.E: '210 mm' has the wrong unit; expected a number in Pa, for "
        'example "210 GPa"',
    ),
    "unit unknown": (
        '"210 GPa"',
        '"210 GPaa"',
        "materials.steel.E: unknown unit 'GPaa' in '210 GPaa' (did you mean 'GPa'?); expected a "
        'number in Pa, for example "210 GPa"',
    ),
    "E no number": (
        '"210 GPa"',
        '"stiff"',
        "materials.steel.E: 'stiff' is not a number; expected a number in Pa, for "
        'example "210 GPa"',
    ),
    "E list": (
        '"210 GPa"',
        "[1]",
        'materials.steel.E: [1] is not a number; expected a number in Pa, for example "210 GPa"',
    ),
    "E neg": ('"210 GPa"', "-1", "materials.steel.E: -1 is not a possible E; E must be positive"),
    "E bool": (
        '"210 GPa"',
        "true",
        'materials.steel.E: True is not a number; expected a number in Pa, for example "210 GPa"',
    ),
    "nu 0.51": (
        "nu = 0.3",
        "nu = 0.51",
        "materials.steel.nu: 0.51 is not a possible Poisson's ratio; nu must lie above -1 "
        "and not above 0.5 (rubber: 0.49 to 0.5)",
    ),
    "nu 0.5": (
        "nu = 0.3",
        "nu = 0.5",
        "materials.steel.nu: an incompressible material needs a pressure beside the displacement; "
        'mesh.formulation = "mixed" or mesh.degree = 2, or nu below 0.5',
    ),
    "one const": (
        "nu = 0.3\n",
        "",
        "materials.steel: two elastic constants are needed, 1 given (E); give any two of "
        "E, nu, K, lmbda, mu",
    ),
    "three const": (
        "nu = 0.3\n",
        "nu = 0.3\nmu = 1\n",
        "materials.steel: two elastic constants are needed, 3 given (E, nu, mu); give "
        "any two of E, nu, K, lmbda, mu",
    ),
    "no surface": (
        'on = "left"',
        'on = "lft"',
        "support[0].on: there is no surface 'lft'; did you mean 'left'?",
    ),
    "no surface 2": (
        'on = "right"',
        'on = ["right", "tip"]',
        "load[0].on[1]: there is no surface 'tip'; did you mean 'top'?",
    ),
    "region as surface": (
        'on = "left"',
        'on = "core"',
        "support[0].on: 'core' is a region; a support holds surfaces, edges and points",
    ),
    "no region": (
        "nu = 0.3",
        'nu = 0.3\non = "cor"',
        "materials.steel.on: there is no region 'cor'; did you mean 'core'?",
    ),
    "surface as region": (
        "nu = 0.3",
        'nu = 0.3\non = "left"',
        "materials.steel.on: 'left' is a surface; a material fills regions",
    ),
    "on type": ('on = "left"', "on = 3", "support[0].on: 3 is wrong; expected a text or a list"),
    "on missing": ('on = "left"\n', "", "support[0].on: this key is missing"),
    "components": (
        'on = "left"\ndisplacement = [0, 0, 0]',
        'on = "left"\ndisplacement = [0, 0]',
        "support[0].displacement: 2 components given; the body is 3-dimensional, expected 3",
    ),
    "components4": (
        'on = "left"\ndisplacement = [0, 0, 0]',
        'on = "left"\ndisplacement = [0, 0, 0, 0]',
        "support[0].displacement: [0, 0, 0, 0] is not a vector; expected a list of 3 components "
        "(2 in a plane), for example [0, 0, -1]",
    ),
    "load comps": (
        '[0, 0, "1 MPa"]',
        '[0, "1 MPa"]',
        "load[0].value: 2 components given; the body is 3-dimensional, expected 3",
    ),
    "vec no list": (
        '[0, 0, "1 MPa"]',
        '"1 MPa"',
        'load[0].value: "1 MPa" is wrong; expected a list of one number a component, for '
        "example [0, 0, 1]",
    ),
    "load unit": (
        '"1 MPa"',
        '"1 mm"',
        "load[0].value[2]: '1 mm' has the wrong unit; expected a number in Pa, for "
        'example "2 kPa"',
    ),
    "free in load": (
        '"1 MPa"',
        '"free"',
        "load[0].value[2]: unknown name 'free'; known: e, pi, t, x, y, z\n    free\n    ^",
    ),
    "formula name": (
        '"1 MPa"',
        '"2*xx"',
        "load[0].value[2]: unknown name 'xx'; did you mean 'x'?\n    2*xx\n      ^",
    ),
    "formula syntax": (
        '"1 MPa"',
        '"2*x +"',
        "load[0].value[2]: a value is missing at the end\n    2*x +\n         ^",
    ),
    "formula nest": (
        "displacement = [0, 0, 0]",
        'displacement = [0, "0.1*(x", 0]',
        "support[0].displacement[1]: this parenthesis is never closed; add its )\n    0.1*(x\n"
        "        ^",
    ),
    "curve word": (
        'on = "right"',
        'on = "right"\ncurve = "rmap"',
        "load[0].curve: unknown curve 'rmap'; did you mean 'ramp'? expected \"ramp\", "
        '"constant", "smooth", "load-unload", a formula in t, a table [[t, value], ...], '
        '{smooth = [[t, value], ...]}, or {file = "a.csv"}',
    ),
    "curve table": (
        'on = "right"',
        'on = "right"\ncurve = [[0, 0], [0, 1]]',
        "load[0].curve: the times of a curve's table must increase; a jump takes a short time",
    ),
    "two meshes": (
        'unit = "mm"',
        'unit = "mm"\nfile = "a.msh"',
        "mesh: file and box given together; expected exactly one of file, image, box, rectangle, "
        "parts",
    ),
    "no mesh": (
        "box = {size = [2, 1, 1], cells = [2, 1, 1]}\n",
        "",
        "mesh: no mesh is given; expected exactly one of file, image, box, rectangle, parts",
    ),
    "mesh table missing": (
        '[mesh]\nbox = {size = [2, 1, 1], cells = [2, 1, 1]}\nunit = "mm"\ndegree = 1\n',
        "",
        "mesh: this key is missing",
    ),
    "size w box": (
        'unit = "mm"',
        'unit = "mm"\nsize = 2',
        "mesh.size: a box takes no element size; use box.cells",
    ),
    "unit no length": (
        'unit = "mm"',
        'unit = "kg"',
        "mesh.unit: 'kg' is no unit of length of a mesh; known: m, mm, cm, dm, km, um, µm, "
        "μm, nm, in, inch, ft, mil, yd, mi",
    ),
    "unit nonsense": (
        'unit = "mm"',
        'unit = "qq"',
        "mesh.unit: 'qq' is no unit of length of a mesh; known: m, mm, cm, dm, km, um, µm, "
        "μm, nm, in, inch, ft, mil, yd, mi",
    ),
    "degree": (
        "degree = 1",
        "degree = 3",
        "mesh.degree: 3 is wrong; expected 1 or 2",
    ),
    "degree text": (
        "degree = 1",
        'degree = "two"',
        'mesh.degree: "two" is wrong; expected 1 or 2',
    ),
    "box 2 sizes": (
        "size = [2, 1, 1]",
        "size = [2, 1]",
        "mesh.box.size: [2, 1] is wrong; expected a list of 3",
    ),
    "box unit": (
        "size = [2, 1, 1]",
        'size = [2, 1, "1 kg"]',
        "mesh.box.size[2]: '1 kg' has the wrong unit; expected a number in the unit of the mesh, "
        'or a length such as "2 mm"',
    ),
    "cells float": (
        "cells = [2, 1, 1]",
        "cells = [2, 1.5, 1]",
        "mesh.box.cells[1]: 1.5 is wrong; expected a whole number",
    ),
    "cells neg": (
        "cells = [2, 1, 1]",
        "cells = [2, -1, 1]",
        "mesh.box.cells[1]: -1 is wrong; expected a number above 0",
    ),
    "selector at": (
        ', at = "min"',
        "",
        'surfaces.foot: plane and at belong together, as in {plane = "z", at = "min"}',
    ),
    "selector word": (
        'at = "min"',
        'at = "mni"',
        'surfaces.foot.at: should be "min", "max", a number, or a length such as "2 mm"',
    ),
    "selector axis": (
        'plane = "z"',
        'plane = "w"',
        'surfaces.foot.plane: "w" is wrong; known: x, y, z',
    ),
    "selector empty": (
        '{plane = "z", at = "min"}',
        "{}",
        "surfaces.foot: say where: plane and at, box, sphere, cylinder, normal, between, of, or all"
        "; of a CAD file also faces, kind, cone, or torus",
    ),
    "selector str": (
        '{plane = "z", at = "min"}',
        '"z"',
        "surfaces.foot: no surface 'z' in box 2 x 1 x 1; known: back, bottom, core, front, left, "
        "right, top",
    ),
    "region unit": (
        '"1 mm"',
        '"1 s"',
        "regions.core.box[1][0]: '1 s' has the wrong unit; expected a number in the unit of the "
        'mesh, or a length such as "2 mm"',
    ),
    "density dyn": (
        "[statics]\nsteps = 2",
        "[dynamics]\ndt = 0.1\nend = 1.0",
        "materials.steel.density: this key is missing; [dynamics] needs it, for example "
        '"1100 kg/m^3"',
    ),
    "steps 0": (
        "steps = 2",
        "steps = 0",
        "statics.steps: 0 is wrong; expected a number of at least 1",
    ),
    "steps text": (
        "steps = 2",
        'steps = "many"',
        'statics.steps: "many" is wrong; expected a whole number',
    ),
    "method": (
        '"direct"',
        '"dircet"',
        "solver.method: \"dircet\" is wrong; did you mean 'direct'?",
    ),
    "field": (
        '["displacement"]',
        '["displacment"]',
        "output.fields[0]: there is no field 'displacment'; did you mean 'displacement'?",
    ),
    "field motion": (
        '["displacement"]',
        '["displacement", "velocity"]',
        "output.fields[1]: there is no 'velocity' in statics; leave it out, or use [dynamics]",
    ),
    "fields str": (
        '["displacement"]',
        '"displacement"',
        'output.fields: "displacement" is wrong; expected a list',
    ),
    "single bracket": (
        "[[support]]",
        "[support]",
        "support: [support] is one table, and a list of tables is needed; write [[support]] with "
        "double brackets",
    ),
    "material flat": (
        "[materials.steel]",
        "[materials]",
        'materials.law: "linear-elastic" is no material; write its table as [materials.NAME]',
    ),
    "no material": (
        '[materials.steel]\nlaw = "linear-elastic"\nE = "210 GPa"\nnu = 0.3\n',
        "",
        "materials: this key is missing",
    ),
    "two everywhere": (
        "[[support]]",
        '[materials.alu]\nlaw = "linear-elastic"\nE = 1\nnu = 0.1\n[[support]]',
        "materials.alu: 'steel' and 'alu' both have no `on`; only one material can fill "
        "what the others leave",
    ),
    "overlap": (
        "nu = 0.3",
        "nu = 0.3\n"
        'on = "core"\n'
        "[materials.alu]\n"
        'law = "linear-elastic"\n'
        "E = 1\n"
        "nu = 0.1\n"
        'on = "core"',
        "materials.alu.on: 6 elements are in 'steel' too; every element needs exactly one material",
    ),
    "uncovered": (
        "nu = 0.3",
        'nu = 0.3\non = "core"',
        "materials: 6 of 12 elements have no material; a material without `on` fills what "
        "the others leave",
    ),
    "no support": (
        '[[support]]\non = "left"\ndisplacement = [0, 0, 0]\n',
        "",
        "support: there is no support: as a rigid body it can move and turn freely; "
        "equilibrium needs supports that hold it; [dynamics] does not",
    ),
    "slides": (
        'on = "left"\ndisplacement = [0, 0, 0]',
        'on = "left"\ndisplacement = [0, "free", 0]',
        "support: the supports leave the body free: as a rigid body it can move along y; "
        "equilibrium needs supports that hold it; [dynamics] does not",
    ),
    "rolls": (
        'on = "left"\ndisplacement = [0, 0, 0]',
        'on = "left"\ndisplacement = [0, "free", "free"]',
        "support: the supports leave the body free: as a rigid body it can move along y, "
        "move along z, turn about x through (1, 0.5, 0.5) mm; equilibrium needs supports "
        "that hold it; [dynamics] does not",
    ),
    "toml": (
        "steps = 2",
        "steps 2",
        "line 22: there is no = behind the key\n    steps 2\n          ^",
    ),
    "toml twice": (
        "steps = 2",
        "steps = 2\nsteps = 3",
        "line 23: this key stands here for the second time\n    steps = 3\n             ^",
    ),
    "toml comma": (
        "steps = 2",
        "rtol = 0,1",
        "line 22: a decimal point is needed in place of the comma\n    rtol = 0,1\n            ^",
    ),
    "toml string": (
        'title = "Block"',
        'title = "Block',
        'line 1: the closing quote is missing\n    title = "Block\n                  ^',
    ),
    "toml quotes": (
        "steps = 2",
        "max_step = 5 %",
        "line 22: something stands behind the value; texts, values with units and formulas stand "
        'in quotes: "1 MPa", "2*x"\n    max_step = 5 %\n                 ^',
    ),
    "title": ('title = "Block"', "title = 3", "title: 3 is wrong; expected a text"),
    "pictures of one name": (
        "fields =",
        'pictures = [{}, {view = "x"}]\nfields =',
        "output.pictures[1].file: 'picture.png' is the file of a picture above; a file of its own",
    ),
    "a picture without its table": (
        "fields =",
        'pictures = "a.png"\nfields =',
        'output.pictures: "a.png" is wrong; write pictures = [{file = "a.png"}]',
    ),
    "pictures": (
        "fields =",
        'pictures = [{feild = "x"}]\nfields =',
        "output.pictures[0]: unknown key 'feild'; did you mean 'field'?",
    ),
    "curve const": (
        'on = "right"',
        'on = "right"\ncurve = "1/0"',
        "load[0].curve: '1/0' is infinite",
    ),
    "toml twice t": (
        "[solver]",
        "[mesh]\n[solver]",
        "line 23: [mesh] stands here for the second time\n    [mesh]\n         ^",
    ),
    "density": (
        "[statics]",
        '[[load]]\nkind = "gravity"\n[statics]',
        "materials.steel.density: this key is missing; load[1] (gravity) needs it, for "
        'example "1100 kg/m^3"',
    ),
    "unit for surveyors": (
        'unit = "mm"',
        'unit = "furlong"',
        "mesh.unit: 'furlong' is no unit of length of a mesh; known: m, mm, cm, dm, km, um, µm, "
        "μm, nm, in, inch, ft, mil, yd, mi",
    ),
    "toml closing bracket": (
        'fields = ["displacement"]',
        'fields = ["displacement"',
        "the list has no closing bracket ] (at end of document)",
    ),
    "toml closing bracket before a heading": (
        '"1 MPa"]',
        '"1 MPa"',
        "line 21: the list has no closing bracket ]\n    [statics]\n    ^",
    ),
}


@pytest.mark.parametrize("name", MISTAKES)
def test_mistake(folder: Path, name: str) -> None:
    """File, dotted key, what is wrong, what is expected: in one message."""
    old, new, message = MISTAKES[name]
    assert old in GOOD
    assert message_of(folder, GOOD.replace(old, new, 1)) == f"case.toml: {message}"


def test_a_load_that_ends_is_found_by_the_run(folder: Path) -> None:
    """Its resultant is not listed then, but a run begins: it may end before that time."""
    ends = MOTION.replace('"1 MPa"', '"1e3*sqrt(0.45 - t)"')
    states = run(case_of(folder, ends))
    assert [next(states).step for _ in range(4)] == [0, 1, 2, 3]
    with pytest.raises(InputError, match=r"load\[0\]\.value\[2\]: '1e3.* no finite value at t = "):
        list(states)


MOTION = GOOD.replace("nu = 0.3", "nu = 0.3\ndensity = 7850").replace(
    "[statics]\nsteps = 2", "[dynamics]\ndt = 0.1\nend = 1"
)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (
            "dt = 0.1\n",
            "",
            "dynamics.dt: this key is missing; 'generalized-alpha' needs a time step, for example "
            '"1 ms"',
        ),
        (
            "dt = 0.1",
            'dt = "1 mm"',
            "dynamics.dt: '1 mm' has the wrong unit; expected a number in s, for example \"0.1 s\"",
        ),
        ("dt = 0.1", "dt = 0", "dynamics.dt: 0 is wrong; expected a number above 0"),
        ("end = 1", "", "dynamics.end: this key is missing"),
        (
            "end = 1",
            'end = 1\nscheme = "newmarc"',
            "dynamics.scheme: \"newmarc\" is wrong; did you mean 'newmark'?",
        ),
        (
            "end = 1",
            "end = 1\ninitial_velocity = [0, 3]",
            "dynamics.initial_velocity: 2 components given; the body is 3-dimensional, expected 3",
        ),
        (
            "degree = 1\n[surfaces]",
            'degree = 2\n[dynamics]\nscheme = "symplectic-euler"\nend = 1\n[surfaces]',
            "mesh.degree: symplectic-euler has a lumped mass, for linear elements only; "
            "use degree = 1 or generalized-alpha",
        ),
        *(
            (
                "degree = 1\n[surfaces]",
                f'{more}[dynamics]\nscheme = "central-differences"\nend = 1\n'
                '[materials.gel]\nlaw = "neo-hookean"\nE = 1e6\nnu = 0.5\ndensity = 1e3\n'
                'on = "core"\n[surfaces]',
                "materials.gel.nu: 'central-differences' solves for displacements only, and an "
                "incompressible material needs a pressure beside them; a nu below 0.5, such as "
                '0.49, or dynamics.scheme = "generalized-alpha" with mesh.formulation = "mixed"',
            )
            for more in ("", "degree = 2\n", 'formulation = "mixed"\n')
        ),
    ],
)
def test_mistake_in_motion(folder: Path, old: str, new: str, message: str) -> None:
    """The same for [dynamics]."""
    text = MOTION
    if "[dynamics]" in new:
        text = text.replace("[dynamics]\ndt = 0.1\nend = 1", "")
    assert message_of(folder, text.replace(old, new, 1)) == f"case.toml: {message}"


def test_good_motion(folder: Path) -> None:
    """Motion needs no support; the explicit scheme no equations."""
    text = MOTION[: MOTION.index("[[support]]")] + MOTION[MOTION.index("[[load]]") :]
    assert report(case_of(folder, text)).analysis == "dynamics"
    text = text.replace("dt = 0.1", 'scheme = "symplectic-euler"')
    message = "solver.method: the scheme 'symplectic-euler' solves no equations; leave it out"
    assert message_of(folder, text) == f"case.toml: {message}"
    text = text.replace('method = "direct"', 'method = "auto"')
    assert report(case_of(folder, text)).linear_solver == "none: explicit scheme"


def test_other_mistakes(folder: Path) -> None:
    """Those that are not a change of the text of one case."""
    assert (
        message_of(folder, GOOD.replace('on = "left"', "on = []"))
        == "case.toml: support[0].on: no name is given; a surface's name"
    )
    assert (
        message_of(folder, GOOD.replace("Block", "\udcff"))
        == "case.toml: this is no text file in UTF-8; save it in UTF-8"
    )
    text = GOOD.replace("box = {size = [2, 1, 1], cells = [2, 1, 1]}", 'file = "part.msh"')
    assert message_of(folder, text).startswith(
        "case.toml: mesh.file: there is no mesh file 'part.msh'"
    )
    text = GOOD.replace('at = "min"', "at = 5")
    assert message_of(folder, text).startswith("case.toml: surfaces.foot: found 0 of 20 facets")
    text = GOOD.replace("[materials.steel]", '[materials."my steel"]\nnuu = 3')
    assert (
        message_of(folder, text)
        == "case.toml: materials.\"my steel\": unknown key 'nuu'; did you mean 'nu'?"
    )


ODD = (
    None,
    True,
    -1,
    10**400,
    float("nan"),
    "",
    "x" * 3000,
    "1 mm",
    "1/0",
    [],
    [[]],
    {},
    {"kind": []},
    [{"on": "left"}],
    [None],
)


def _places(value: Any, place: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    if place:
        yield place
    entries = (
        value.items()
        if isinstance(value, dict)
        else (enumerate(value) if isinstance(value, list) else ())
    )
    for key, inner in entries:
        yield from _places(inner, (*place, key))


@pytest.mark.parametrize("text", [GOOD, MOTION], ids=["statics", "dynamics"])
def test_any_value_anywhere(text: str) -> None:
    """Whatever stands at any place of a case, it is read or refused as an InputError."""
    for place in _places(tomllib.loads(text)):
        for odd in ODD:
            tables = inner = tomllib.loads(text)
            for key in place[:-1]:
                inner = inner[key]
            inner[place[-1]] = odd
            with suppress(InputError):
                Case.from_dict(tables, file="case.toml").to_toml()


AWAY = "/nowhere/data/part"
XDMF = f"""<Xdmf Version="3.0"><Domain><Grid Name="mesh" GridType="Uniform">
<Topology TopologyType="Tetrahedron"><DataItem Dimensions="1 4" Format="HDF">{AWAY}.h5:/t</DataItem>
</Topology></Grid></Domain></Xdmf>"""
OUTSIDE: dict[str, tuple[str, str]] = {
    "case": ("", ""),
    "mesh": (f"{AWAY}.msh", ""),
    "curve": ("", ""),
    "included": ("deck.inp", f"*NODE\n1, 0., 0., 0.\n*INCLUDE, INPUT={AWAY}.inp\n"),
    "numbers": ("part.xdmf", XDMF),
}
"""Kind to the mesh file of the case, and its content."""


@pytest.mark.parametrize(
    ("earlier", "on"),
    [
        ({"kind": "traction", "force": [0, 0, "-2 kN"]}, "right"),
        ({"kind": "point-force", "value": [0, 0, "-2 kN"], "total": True}, "tips"),
        ({"kind": "line-force", "value": [0, 0, "-2 kN"], "total": True}, "rim"),
    ],
)
def test_earlier_spellings_of_a_total_force(earlier: dict[str, Any], on: str) -> None:
    [load], [now] = (
        Case(
            mesh={"box": {"size": [1, 1, 1], "cells": [1, 1, 1]}, "unit": "m"},
            materials={"a": {"law": "linear-elastic", "E": 1, "nu": 0.3}},
            support=[{"on": "left"}],
            load=[{**row, "on": on}],
        ).load
        for row in (earlier, {"kind": "force", "value": [0, 0, "-2 kN"]})
    )
    assert load == now


@pytest.mark.parametrize("kind", OUTSIDE)
def test_files_that_docker_run_does_not_show(
    folder: Path, kind: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """They were called missing, with the nearest name in a folder that is not the user's."""
    monkeypatch.setenv("DOLFIN_ELASTIC_SHOWN", f"{folder}:/somewhere/else")
    mesh, content = OUTSIDE[kind]
    text = GOOD
    if mesh:
        text = GOOD.replace("box = {size = [2, 1, 1], cells = [2, 1, 1]}", f'file = "{mesh}"')
    if kind == "curve":
        text = GOOD.replace("[[load]]", f'[[load]]\ncurve = {{file = "{AWAY}.csv"}}', 1)
    path = Path(f"{AWAY}.toml") if kind == "case" else folder / "case.toml"
    if kind != "case":
        on_root(MPI.COMM_WORLD, lambda: path.write_text(text))
    if content:
        on_root(MPI.COMM_WORLD, lambda: (folder / mesh).write_text(content))
    with pytest.raises(InputError) as caught:
        read_case(path).read_body()
    assert "DOLFIN_ELASTIC_BIND=/nowhere/data in front of the command" in str(caught.value)
    monkeypatch.delenv("DOLFIN_ELASTIC_SHOWN")  # on the machine itself
    with pytest.raises(InputError) as caught:
        read_case(path).read_body()
    said = ("there is no", "is not beside it")
    assert any(words in str(caught.value) for words in said)
    assert "BIND" not in str(caught.value)


def test_missing_case_file(folder: Path) -> None:
    """The nearest file is named; a folder is no file."""
    case_of(folder, GOOD)
    with pytest.raises(InputError) as caught:
        read_case(folder / "cas.toml")
    assert str(caught.value) == (
        f"{folder}/cas.toml: there is no such case file; did you mean '{folder}/case.toml'?"
    )
    with pytest.raises(InputError, match="this is a folder, not a file"):
        read_case(folder)
    # Folder and suffix, which all have, make no name alike.
    with pytest.raises(InputError) as caught:
        read_case(folder / "plate.toml")
    assert str(caught.value) == (
        f"{folder}/plate.toml: there is no such case file; known: {folder}/case.toml"
    )


def test_good_case(folder: Path) -> None:
    """What a report says about it."""
    found = report(case_of(folder, GOOD))
    assert (found.dim, found.cells, found.unknowns, found.analysis) == (3, 12, 36, "statics")
    assert found.title == "Block"
    assert found.notes == ()
    surfaces = {part.name: part for part in found.surfaces}
    assert surfaces["foot"].measure == pytest.approx(2e-6)
    assert surfaces["left"].use == "support"
    assert surfaces["right"].use == "traction"
    regions = {part.name: part for part in found.regions}
    assert regions["core"].measure == pytest.approx(1e-9)
    assert regions["(whole body)"].count == 12


def test_notes(folder: Path) -> None:
    """What is not wrong but should be known."""
    text = GOOD.replace("linear-elastic", "textbook")
    assert (
        report(case_of(folder, text))
        .notes[0]
        .startswith("materials.steel: the law 'textbook' has no energy")
    )
    text = GOOD[: GOOD.index("[[load]]")]
    assert report(case_of(folder, text)).notes == (
        "there is no load and every support is at rest: nothing will move",
    )


def test_a_warning_of_a_law_is_given_once(folder: Path, caplog: Any) -> None:
    """By the problem, so that it is given in Python, too; a run does not repeat it."""
    read = case_of(folder, GOOD.replace("linear-elastic", "textbook"))
    body = read.read_body()
    assert check(read, body) == ()
    read.make_problem(body)
    warnings = [r.getMessage() for r in caplog.records if "has no energy" in r.getMessage()]
    assert len(MPI.COMM_WORLD.bcast(warnings)) == 1


def test_round_trip(folder: Path) -> None:
    """A case written back and read again is equal, also after pickling."""
    more = (
        '[materials.rubber]\nlaw = "neo-hookean"\nK = 1e6\nlambda = 9e5\non = ["core"]\n'
        '[[support]]\non = ["right"]\ndisplacement = ["free", "2 mm", "x*t^2"]\n'
        'curve = [[0, 0], [1, 2.5]]\n[[load]]\nkind = "body-force"\nvalue = [0, 0, 1]\n'
        '[output]\nfolder = "a \\"b\\""\nevery = 3\n[solver]\n'
        'petsc = {ksp_type = "cg", ksp_rtol = 1e-6}\n'
    )
    case = case_of(folder, GOOD[: GOOD.index("[solver]")] + more)
    again = Case.from_dict(tomllib.loads(case.to_toml()), case.folder, file=case.file)
    assert again == case
    assert again.to_toml() == case.to_toml()
    assert pickle.loads(pickle.dumps(case)) == case
    assert case.materials["rubber"].law.nu == again.materials["rubber"].law.nu


def test_parts_of_one_selector_and_of_two() -> None:
    """Written as a table and as a list of tables; none of them is lost."""
    one, two = {"plane": "x", "at": 0.0}, {"plane": "x", "at": 1.0}
    case = Case(
        mesh={"box": {"size": [1, 1, 1], "cells": [1, 1, 1]}, "degree": 1},
        surfaces={"foot": one, "ends": [one, two]},
        materials={"m": {"law": "neo-hookean", "E": "1 MPa", "nu": 0.3}},
    )
    written = case.to_dict()["surfaces"]
    assert written["foot"]["at"] == 0.0
    assert [row["at"] for row in written["ends"]] == [0.0, 1.0]
    assert Case.from_dict(case.to_dict()).surfaces == case.surfaces


def test_case_in_python() -> None:
    """The same records without a file; errors name the key alone."""
    case = Case(
        mesh={"box": {"size": [1, 1, 1], "cells": [1, 1, 1]}, "degree": 1},
        materials={"m": {"law": "neo-hookean", "E": "1 MPa", "nu": 0.3}},
        support=[{"on": "left"}],
    )
    assert case.results_folder() == Path("case_results")
    assert report(case).unknowns == 24
    with pytest.raises(InputError) as caught:
        Case(mesh={"box": {"size": [1, 1, 1], "cells": [1, 1, 1]}, "degree": 1}, materials={"m": 3})
    assert str(caught.value) == "materials.m: 3 is no material; write its table as [materials.NAME]"


@pytest.mark.parametrize("kind", Kind)
def test_starters(kind: Kind, folder: Path) -> None:
    """The cases that `new` writes have nothing wrong with them."""
    case, *others = template(kind, folder / "case.toml").items()
    for path, text in others:
        if COMM.rank == 0:
            path.write_text(text)
    found = report(case_of(folder, case[1]))
    assert found.notes == ()


def test_support_without_displacement_in_the_plane(folder: Path) -> None:
    """It holds as many components as the body has."""
    text = (
        "[mesh]\nrectangle = {size = [2, 1], cells = [2, 1]}\ndegree = 1\n[materials.m]\n"
        'law = "neo-hookean"\nE = 1\nnu = 0.3\n[[support]]\non = "left"\n'
    )
    case = case_of(folder, text)
    assert report(case).dim == 2
    problem = case.make_problem(case.read_body())
    assert problem.supports[0].values_in(2) == (0.0, 0.0)


@pytest.mark.parametrize(
    ("supports", "free"),
    [
        ([], ["move and turn freely"]),
        ([{"on": "left"}], []),
        (
            [{"on": "left", "displacement": [0, "free", "free"]}],
            [
                "move along y",
                "move along z",
                "turn about x through (1, 0.5, 0.5) mm",
            ],
        ),
        (
            [
                {"on": "left", "displacement": [0, "free", "free"]},
                {"on": "bottom", "displacement": ["free", "free", 0]},
            ],
            ["move along y"],
        ),
        (
            [
                {"on": "left", "displacement": [0, "free", "free"]},
                {"on": "front", "displacement": ["free", 0, "free"]},
                {"on": "bottom", "displacement": ["free", "free", 0]},
            ],
            [],
        ),
    ],
)
def test_free_motions(supports: list[dict[str, object]], free: list[str]) -> None:
    """Rigid motions are found from the supports' rank, not from a guess."""
    tables = {**tomllib.loads(GOOD), "support": supports}
    case = Case.from_dict(tables)
    assert free_motions(case.make_problem(case.read_body())) == free


def test_materials_fill_what_others_leave() -> None:
    """Each material gets a region; without `on` it is the rest."""
    tables = tomllib.loads(GOOD)
    tables["materials"]["rubber"] = {"law": "neo-hookean", "E": 1, "nu": 0.3, "on": "core"}
    case = Case.from_dict(tables)
    problem = case.make_problem(case.read_body())
    cells = {part.name: COMM.allreduce(len(part.cells)) for part in problem.regions}
    assert cells == {"steel": 6, "rubber": 6}


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("size = [2, 1, 1]", "size = [2 1, 1]", ": a comma is missing in the list\n"),
        (
            "[statics]",
            '[[load]]\nkind = "force"\non = "right"\nvalue = "-2 kN"\n[statics]',
            'load[1].value: "-2 kN" is wrong; expected a list of one number a component, for '
            'example [0, 0, "-2 kN"]',
        ),
        (
            "[statics]",
            '[[load]]\nkind = "force"\non = "right"\ncurve = 3\nvalue = "-2 kN"\n[statics]',
            '"a.csv"}\ncase.toml: load[1].value: "-2 kN" is wrong; expected a list of one number',
        ),
        (
            '[[support]]\non = "left"',
            '[[support]]\nkind = "fixed"\non = "left"',
            "support[0]: unknown key 'displacement'; displacement belongs to kind = ",
        ),
        (
            'E = "210 GPa"',
            'E = "210 GPa"\nyield = "235 MPa"',
            "materials.steel: unknown key 'yield'; did you mean 'allowable'?",
        ),
        (
            '[[support]]\non = "left"',
            '[[support]]\nkind = "clamp"\non = "left"',
            "support[0].kind: unknown kind 'clamp'; did you mean 'fixed'? known: fixed, displ",
        ),
        (
            'fields = ["displacement"]',
            'fields = ["safety factor"]',
            "output.fields[0]: there is no field 'safety factor'; did you mean 'safety_factor'?",
        ),
        (
            'fields = ["displacement"]',
            'fields = ["displacement"]\npictures = [{view = "y-"}]',
            "output.pictures[0].view: \"y-\" is wrong; did you mean '-y'? known: isometric, x, y, "
            "z, -x, -y, -z",
        ),
        (
            'fields = ["displacement"]',
            'fields = ["fibre_strain"]',
            "output.fields[0]: no material has a first direction of fibres; leave the field out, "
            "or a law with fibres",
        ),
    ],
    ids=["comma", "force", "curve", "fixed", "yield", "clamp", "safety factor", "view", "fibre"],
)
def test_slips(folder: Path, old: str, new: str, message: str) -> None:
    assert old in GOOD
    assert message in message_of(folder, GOOD.replace(old, new, 1))


def test_all_errors_are_told(folder: Path) -> None:
    """Each with its key, in the order of the file; what follows from another is left out."""
    text = (
        GOOD.replace("degree = 1", "degree = 3\nunits = 1")
        .replace('law = "linear-elastic"', 'law = "linear-elastic"\nyield = 3\ndensity = "1 m"')
        .replace("nu = 0.3", "nu = 0.3\nexpansion = [1]")
        .replace('on = "left"', 'onn = "left"')
        .replace('kind = "traction"', 'kind = "tracktion"')
        .replace("steps = 2", "steps = true\nend = -1")
    )
    text += '[[load]]\nkind = "gravity"\non = 3\n'
    said = message_of(folder, text).splitlines()
    keys = [line.removeprefix("case.toml: ").partition(": ")[0] for line in said]
    assert keys == [
        "mesh",
        "mesh.degree",
        "materials.steel",
        "materials.steel.density",
        "materials.steel.expansion",
        "support[0]",
        "load[0].kind",
        "load[1].on",
        "statics.steps",
        "statics.end",
    ]
    assert said[5] == "case.toml: support[0]: unknown key 'onn'; did you mean 'on'?"


def test_errors_stand_in_the_order_of_the_file(folder: Path) -> None:
    """Whichever table it begins with."""
    head, tail = GOOD.split("[mesh]")
    middle, end = f"[mesh]{tail}".replace('"linear-elastic"', '"z"').split("[[support]]")
    end = end.replace("displacement =", "kind = 'y'\ndisplacement =")
    end = end.replace('"traction"', '"x"').replace("steps = 2", "steps = 0")
    text = f"{head}[[support]]{end}{middle.replace('degree = 1', 'degree = 7')}"
    said = [line.removeprefix("case.toml: ") for line in message_of(folder, text).splitlines()]
    assert [line.partition(": ")[0] for line in said] == [
        "support[0].kind",
        "load[0].kind",
        "statics.steps",
        "mesh.degree",
        "materials.steel.law",
    ]


def test_the_words_of_an_engineer(folder: Path) -> None:
    """What works works; all others get the right word in one run."""
    text = (
        GOOD.replace('law = "linear-elastic"', 'material = "steel"')
        .replace('E = "210 GPa"\nnu = 0.3', "yield = 1")
        .replace('on = "left"\ndisplacement = [0, 0, 0]', 'kind = "fixed"\non = "left"')
        .replace('kind = "traction"', 'kind = "force"')
        .replace('[0, 0, "1 MPa"]', '[0, 0, "1 kN"]')
        .replace('["displacement"]', '["safety factor"]')
    )
    said = [line.removeprefix("case.toml: ") for line in message_of(folder, text).splitlines()]
    assert said[0] == "materials.steel: unknown key 'yield'; did you mean 'allowable'?"
    assert said[1].startswith(
        "materials.steel.material: there is no material 'steel' in the library; known: "
        '"steel S235", "steel S275",'
    )
    assert (
        said[2]
        == "output.fields[0]: there is no field 'safety factor'; did you mean 'safety_factor'?"
    )
    assert len(said) == 3
    text = text.replace('"steel"', '"steel S235"').replace("yield = 1", 'allowable = "200 MPa"')
    found = report(case_of(folder, text.replace("safety factor", "safety_factor")))
    assert [row.force for row in found.loads] == [pytest.approx((0, 0, 1000))]


def test_all_names_that_are_missing_are_told(folder: Path) -> None:
    text = GOOD.replace('on = "left"', 'on = ["left", "lef", "foto"]')
    text = text.replace(
        "[materials.steel]", '[output]\nfields = ["safety_factor"]\n[materials.steel]'
    )
    text = text.partition('[output]\nfields = ["displacement"]')[0]
    text += '[[load]]\nkind = "gravity"\n[[load]]\nkind = "force"\non = "rihgt"\nvalue = [1, 2]\n'
    said = [line.removeprefix("case.toml: ") for line in message_of(folder, text).splitlines()]
    assert [line.partition(": ")[0] for line in said] == [
        "output.fields[0]",
        "materials.steel.density",
        "support[0].on[1]",
        "support[0].on[2]",
        "load[2].on",
        "load[2].value",
    ]
    assert said[2].endswith("there is no surface 'lef'; did you mean 'left'?")


def keys_of(folder: Path, text: str) -> list[str]:
    """Keys of all errors that a check tells, in their order. Collective."""
    said = [line.removeprefix("case.toml: ") for line in message_of(folder, text).splitlines()]
    return [line.partition(": ")[0] for line in said]


def test_errors_of_keys_and_of_the_mesh_are_told_in_one_round(folder: Path) -> None:
    """Names of good tables are compared with the mesh although others are wrong."""
    text = (
        GOOD.replace("nu = 0.3", "nu = 0.7")
        .replace('on = "left"\ndisplacement = [0, 0, 0]', 'onn = "lef"\ndisplacement = [0, 0]')
        .replace('on = "right"', 'on = "rihgt"')
        .replace("steps = 2", "steps = 0")
    )
    text += """probes = {tip = {at = [9, 9, 9]}}
[[load]]
kind = "tracktion"
on = "nowhere"
[[load]]
kind = "pressure"
on = "topp"
value = 1
[materials.core]
law = "linear-elastic"
E = 1
nu = 0.3
on = "cores"
"""
    assert keys_of(folder, text) == [
        "materials.steel.nu",
        "materials.core.on",
        "support[0]",
        "load[0].on",
        "load[1].kind",
        "load[2].on",
        "statics.steps",
    ]
    assert keys_of(folder, text.replace("degree = 1", "degree = 3"))[0] == "mesh.degree"


def test_vectors_of_another_dimension_are_told_in_one_round() -> None:
    """Of a plane body: an axis, a point, two loads and an obstacle of three dimensions."""
    case = Case.from_dict(
        {
            "mesh": {"rectangle": {"size": [2, 1], "cells": [2, 1]}},
            "materials": {"m": {"law": "neo-hookean", "E": "1 MPa", "nu": 0.3, "density": 1}},
            "support": [
                {"kind": "rotation", "on": "left", "axis": "x", "point": [0, 0, 0], "angle": 1}
            ],
            "load": [
                {"kind": "traction", "on": "right", "value": [1, 0, 0]},
                {"kind": "gravity", "value": [0, 0, -9.81]},
            ],
            "contact": [{"on": "top", "plane": {"axis": "z", "at": 2}}],
        }
    )
    with pytest.raises(InputError) as caught:
        check(case, case.read_body())
    places = ["load[0].value", "load[1].value", "contact[0].plane.axis"]
    assert [error.where for error in caught.value.each] == [
        "support[0].axis",
        "support[0].point",
        *places,
    ]


def test_what_refers_to_a_wrong_name_is_no_further_error(folder: Path) -> None:
    """Neither where its selector is wrong, nor where the mesh has no such place."""
    for wrong, key in (('at = "mi"', "surfaces.foot.at"), ("at = 7", "surfaces.foot")):
        text = GOOD.replace('at = "min"', wrong).replace('on = "left"', 'on = ["foot", "lef"]')
        text = text.replace("[regions]", 'sole = {of = "foot"}\n[regions]')
        text = text.replace('on = "right"', 'on = "rihgt"')
        assert keys_of(folder, text) == [key, "load[0].on"]
    text = GOOD.replace("[surfaces]", "[surfces]").replace('on = "left"', 'on = "foot"')
    assert len(keys_of(folder, text)) == 1
    text = GOOD.replace("steps = 2", "steps = 0").replace('"displacement"]', '"velocity"]')
    assert keys_of(folder, text) == ["statics.steps"]


def test_names_and_materials_are_told_in_one_round(folder: Path) -> None:
    text = GOOD.replace("nu = 0.3", 'nu = 0.3\non = "core"').replace('"right"', '"rihgt"')
    text += "probes = {tip = {at = [9, 9, 9]}}\n"
    assert keys_of(folder, text) == ["materials", "load[0].on", "output.probes"]


SHOP = """
["PETG, ours"]
E = "1.6 GPa"
nu = 0.39
yield = "30 MPa"
source = "tests of ours"
["steel S235"]
E = "200 GPa"
nu = 0.25
"""


def shop_case(folder: Path, name: str, library: str = SHOP) -> Case:
    if COMM.rank == 0:
        (folder / "shop.toml").write_text(library)
    COMM.barrier()
    text = GOOD.replace('title = "Block"', 'library = "shop.toml"')
    old = 'law = "linear-elastic"\nE = "210 GPa"\nnu = 0.3\n'
    assert old in text
    return case_of(folder, text.replace(old, f'material = "{name}"\n'))


def test_a_library_of_ones_own(folder: Path) -> None:
    """It wins over that of the program, which stays beside it."""
    for name, E, allowable, source in (
        ("petg, ours", 1.6e9, 30e6, "PETG, ours: tests of ours"),
        ("steel S235", 200e9, None, "steel S235"),
        ("steel S355", 210e9, 355e6, "steel S355: E, nu"),
    ):
        case = shop_case(folder, name)
        (material,) = case.materials.values()
        assert (material.law.E, material.law.allowable) == (E, allowable)
        assert material.source.startswith(source)
        assert Case.from_dict(case.to_dict()).to_dict() == case.to_dict()


@pytest.mark.parametrize(
    ("name", "library", "says"),
    [
        ("PETG, or", SHOP, "materials.steel.material: there is no material 'PETG, or' in the lib"),
        (
            "PLA",
            SHOP.replace("nu =", "nuu ="),
            "shop.toml: \"PETG, ours\": unknown key 'nuu'",
        ),
        ("PLA", "[a]\nalso = 1", 'shop.toml: "a".also: 1 is wrong; expected a list'),
        ("PLA", "[a]\nlaw = [1]", 'shop.toml: "a".law: unknown law'),
        ("PLA", "a = 1", 'shop.toml: "a": 1 is wrong; expected a table'),
        ("PLA", "[a", "case.toml: library: shop.toml: the heading has no closing bracket"),
    ],
)
def test_a_wrong_library(folder: Path, name: str, library: str, says: str) -> None:
    with pytest.raises(InputError) as caught:
        shop_case(folder, name, library)
    assert says in str(caught.value).replace(f"{folder}/", "")


def test_a_wrong_library_hides_nothing(folder: Path) -> None:
    text = GOOD.replace("degree = 1", "degree = 7").replace("[statics]", "[statics]\nend = -1")
    text = text.replace('title = "Block"', 'library = "shp.toml"\ntitel = 3')
    said = [line.removeprefix("case.toml: ") for line in message_of(folder, text).splitlines()]
    keys = sorted(line.partition(": ")[0] for line in said)
    assert keys == [
        "library",
        "mesh.degree",
        "statics.end",
        "unknown key 'titel'; did you mean 'title'?",
    ]


def test_a_library_that_is_not_there(folder: Path) -> None:
    text = GOOD.replace('title = "Block"', 'library = "shp.toml"')
    assert message_of(folder, text).startswith("case.toml: library: shp.toml: there is no such ")


def test_moments_without_any_support(folder: Path) -> None:
    support = '[[support]]\non = "left"\ndisplacement = [0, 0, 0]\n'
    assert support in GOOD
    text = GOOD.replace(support, "") + 'moments = {bolts = "middle"}\n'
    told = "there is no support or contact 'bolts'; nothing holds the body: write [[support]]"
    assert message_of(folder, text) == f"case.toml: output.moments.bolts: {told}"


def test_bounds_are_told_with_the_unit_that_was_written() -> None:
    table = {"law": "guccione", "C": "-2 kPa", "bf": 8, "bt": 3, "bfs": 4, "fibre": [1, 0, 0]}
    with pytest.raises(InputError, match=r'\.C: "-2 kPa" is wrong; expected a number above 0'):
        Case.from_dict(
            {"mesh": {"box": {"size": [1, 1, 1], "cells": [1, 1, 1]}}, "materials": {"m": table}}
        )
