"""Scripts of Gmsh describe bodies: none runs a command or writes a file."""

from __future__ import annotations

from pathlib import Path

import pytest
from mpi4py import MPI

from dolfin_elastic.core.errors import MeshError
from dolfin_elastic.core.parallel import on_root
from dolfin_elastic.mesh import mesh_statistics, read_body
from dolfin_elastic.mesh.formats.cad.script import files_of_script
from dolfin_elastic.mesh.formats.cad.units import stated_unit

BOX = 'SetFactory("OpenCASCADE");\nBox(1) = {0, 0, 0, 1, 1, 1};\n'
COMMANDS = {
    "system": 'SystemCall "touch trace";',
    "short": 'System "touch trace";',
    "background": 'NonBlockingSystemCall "touch trace"; Sleep 1;',
    "of a name": 'StringToName["SystemCall"] "touch trace";',
    "after a number": 'x = 1e3\nSystemCall "touch trace";',
    "in a loop": 'For i In {1:2}\n SystemCall "touch trace";\nEndFor',
    "behind a text": 'x = "//"; SystemCall "touch trace";',
    "lost quotation": "If (0)\n E\" EndIf SystemCall 'touch trace'; \"\nEndIf",
    "field": 'Field[1] = ExternalProcess; Field[1].CommandLine = "touch trace";',
    "redirected": 'Printf("%g", 1 > 0) > "trace";',
    "saved": 'Save "trace.brep";',
    "printed": 'Print "trace.stl";',
    "of a view": 'View "v" { SP(0,0,0){1}; }; Save View[0] "trace.pos";',
    "folder": 'CreateDir "trace";',
    "ended": "Exit;",
    "unzipped": 'Merge "a;touch trace;.gz";',
    "included": 'Include "other.geo";',
    "merged": 'Merge StrCat("oth", "er.geo");',
    "onelab": 'OnelabRun("a", "touch trace");',
}


@pytest.mark.parametrize("kind", COMMANDS)
def test_commands_are_refused(folder: Path, monkeypatch, kind: str) -> None:
    """Before, each of them was carried out: a file `trace` appeared, or the process ended."""
    monkeypatch.chdir(folder)

    def write() -> None:
        (folder / "other.geo").write_text('SystemCall "touch trace";\n')
        (folder / "a.geo").write_text(f"{BOX}{COMMANDS[kind]}\n")

    on_root(MPI.COMM_WORLD, write)
    with pytest.raises(MeshError, match=r"(?s)a\.geo|other\.geo"):
        read_body(folder / "a.geo", size=0.5)
    assert not list(folder.glob("trace*"))


def test_a_script_is_not_read_as_a_mesh(folder: Path, monkeypatch) -> None:
    """Old .msh files are read by Gmsh, which takes a file without header for a script."""
    monkeypatch.chdir(folder)
    text = 'SystemCall "touch trace"; /*\n$MeshFormat\n1.0 0 8\n$EndMeshFormat\n*/\n'
    on_root(MPI.COMM_WORLD, lambda: (folder / "a.msh").write_text(text) and None)
    with pytest.raises(MeshError, match="not a Gmsh mesh"):
        read_body(folder / "a.msh")
    assert not (folder / "trace").exists()


def test_what_describes_a_body_is_read(tmp_path: Path) -> None:
    """Prose in comments and texts, options, loops, included and merged shapes."""
    (tmp_path / "size.geo").write_text("h = 0.5;\n")
    path = tmp_path / "a.geo"
    path.write_text(
        'Include "size.geo"; // Save the mesh of this coordinate System, Print it\n'
        'Merge StrCat(CurrentDirectory, "part.step");\nMerge "PART.STEP";\nMesh.SaveAll = 1;\n'
        f'{BOX}Printf("size %g, System of units", h > 0);\nFor i In {{1:3}}\n p = i;\nEndFor\n'
        'Physical Volume("Exit") = {1};\n'
    )
    assert {file.name for file in files_of_script(path)} == {"a.geo", "size.geo"}


@pytest.mark.parametrize("name", ["../mine/b.step", "deep/../b.step", "{folder}/b.step", "\0"])
def test_names_are_plain_paths_below(tmp_path: Path, name: str) -> None:
    """A copy at such a path would be written outside of the private folder of copies."""
    folder = tmp_path / "mine"
    (folder / "deep").mkdir(parents=True)
    (folder / "b.step").write_text("no body")
    (folder / "a.geo").write_text(f'{BOX}Merge "{name.format(folder=folder)}";\n')
    with pytest.raises(MeshError, match="not in the folder of the script"):
        files_of_script(folder / "a.geo")


def test_a_script_is_in_the_unit_of_the_shapes_that_it_reads(tmp_path: Path) -> None:
    """Those that a comment or a text names are not read."""
    path, read = tmp_path / "a.geo", 'Merge "part.step";'
    units = {
        'v() = ShapeFromFile("part.step");': "mm",
        f"{read} // OCCTargetUnit is left as it is": "mm",
        f"// instead of `Merge' \n/* {read} */ // {read}\n Printf('{read}');": "",
        f'Geometry.OCCTargetUnit = "M"; {read}': "",
    }
    for text, unit in units.items():
        path.write_text(text)
        stated = stated_unit(path)
        assert (stated.name if stated else "") == unit, text
        (tmp_path / "part.step").write_text("no body")
        named = {file.name for file in files_of_script(path)} - {"a.geo"}
        assert named == ({"part.step"} if "OCC" in text or unit else set())


def test_sizes_of_a_script_are_kept_below_the_size_asked_for(folder: Path) -> None:
    """Cells grow from a corner of size 0.02; without it all are of the size asked for."""
    square = "Point(2) = {1,0,0}; Point(3) = {1,1,0}; Point(4) = {0,1,0};\n"
    square += "Line(1) = {1,2}; Line(2) = {2,3}; Line(3) = {3,4}; Line(4) = {4,1};\n"
    square += "Curve Loop(1) = {1:4}; Plane Surface(1) = {1};\n"
    shortest = {}
    for size in (", 0.02", ""):
        text = f"Point(1) = {{0,0,0{size}}}; {square}"
        on_root(MPI.COMM_WORLD, lambda text=text: (folder / "a.geo").write_text(text) and None)
        shortest[size] = mesh_statistics(read_body(folder / "a.geo", size=0.5)).shortest
    # The longest edge of the smallest cell: five times the corner's for a steep growth.
    assert shortest[", 0.02"] < 0.15
    assert shortest[""] > 0.3
