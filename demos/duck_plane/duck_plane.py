"""A flat duck that is pressed into its back pushes outwards there: strain, stress, forces drawn.

Problem
    Every point X of a flat duck is moved down by d exp(-|X - P|^2/w^2), d = 5 mm, w = 18 mm, P half
    of that above its back: a thumb presses a dent of 4 mm into it.  Nothing is in equilibrium; the
    question is with which forces the deformed body answers.

Equations
    Strain E = (grad u + grad u^T)/2, stress sigma = lambda tr(E) I + 2 mu E, in plane strain.
    Inside, stress exerts the force div sigma per volume; the surface pushes on what is around it
    with the traction -sigma n per area.  Stress is symmetric and forces are inner ones: over the
    whole body div sigma and -sigma n have no resultant and no moment.

Discretisation
    None of the fields, which are formulas; integrals by quadrature of degree 10 on triangles.

Result
    `duck_plane.png`: principal strains and stresses as crosses, forces and tractions as arrows.
    The traction points outwards where the duck was pressed.  Resultant and moment vanish to
    round-off.

        python3 demos/duck_plane/duck_plane.py
        mpirun -n 2 python3 demos/duck_plane/duck_plane.py
"""

from __future__ import annotations

from pathlib import Path

import dolfinx
import numpy as np
import ufl

from dolfin_elastic import read_case

HERE = Path(__file__).parent
DENT, WIDTH, THUMB, PRESSED = 5e-3, 18e-3, (-14e-3, 47e-3), (-14e-3, 38e-3)
TOLERANCE = 1e-12
"""Of the sums: round-off; the quadrature of a smooth bell, six elements wide, is as exact."""
RED, BLUE, GREY = "#c0392b", "#2e6da4", "#f2d58a"


def fields(mesh, law):
    """Displacement, strain, stress and force per volume as UFL expressions."""
    X = ufl.SpatialCoordinate(mesh)
    away = X - ufl.as_vector(THUMB)
    u = ufl.as_vector([0, -DENT * ufl.exp(-ufl.dot(away, away) / WIDTH**2)])
    E = ufl.sym(ufl.grad(u))
    sigma = law.lmbda * ufl.tr(E) * ufl.Identity(2) + 2 * law.mu * E
    return X, u, E, sigma, ufl.div(sigma)


def sums(mesh, X, sigma, force):
    """Resultant and moment of force and traction, over the sums of their magnitudes."""
    n = ufl.FacetNormal(mesh)
    push = -sigma * n
    dx, ds = (m(domain=mesh, metadata={"quadrature_degree": 10}) for m in (ufl.dx, ufl.ds))

    def total(inside, outside):
        value = dolfinx.fem.assemble_scalar(dolfinx.fem.form(inside * dx + outside * ds))
        return mesh.comm.allreduce(value)

    def turn(f):
        return X[0] * f[1] - X[1] * f[0]

    size, lever = total(ufl.sqrt(force**2), ufl.sqrt(push**2)), 0.1
    resultant = np.hypot(*(total(force[i], push[i]) for i in range(2))) / size
    return resultant, abs(total(turn(force), turn(push))) / (size * lever)


def at_nodes(mesh, expression, shape):
    """Values of an expression at the vertices, one row each."""
    V = dolfinx.fem.functionspace(mesh, ("Lagrange", 1, shape))
    function = dolfinx.fem.Function(V)
    function.interpolate(dolfinx.fem.Expression(expression, V.element.interpolation_points()))
    return V, function.x.array.reshape(-1, int(np.prod(shape)))


def facets(mesh, V):
    """Nodes of the owned facets of the skin, and their outward normals."""
    mesh.topology.create_connectivity(1, 2)
    mine = mesh.topology.index_map(1).size_local
    skin = dolfinx.mesh.exterior_facet_indices(mesh.topology)
    skin = skin[skin < mine]
    find = dolfinx.fem.locate_dofs_topological
    each = [find(V, 1, np.array([f], dtype=np.int32), remote=False) for f in skin]
    ends = np.array(each).reshape(-1, 2)
    cells = [mesh.topology.connectivity(1, 2).links(f)[0] for f in skin]
    X = V.tabulate_dof_coordinates()[:, :2]
    along = X[ends[:, 1]] - X[ends[:, 0]]
    normal = np.column_stack([along[:, 1], -along[:, 0]])
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    inwards = np.array([X[V.dofmap.cell_dofs(c)].mean(axis=0) for c in cells]).reshape(-1, 2)
    inwards = inwards - X[ends].mean(axis=1)
    return ends, np.where((normal * inwards).sum(axis=1)[:, None] > 0, -normal, normal)


def main():
    case = read_case(HERE / "case.toml")
    body = case.read_body()
    mesh, comm = body.mesh, body.comm
    X, u, E, sigma, force = fields(mesh, case.materials["rubber"].law)
    resultant, moment = sums(mesh, X, sigma, force)

    V, shift = at_nodes(mesh, u, (2,))
    values = [at_nodes(mesh, one, shape)[1] for one, shape in ((E, (2, 2)), (sigma, (2, 2)))]
    values.append(at_nodes(mesh, force, (2,))[1])
    ends, normals = facets(mesh, V)
    places = V.tabulate_dof_coordinates()[:, :2]
    stress = values[1].reshape(-1, 2, 2)[ends].mean(axis=1)
    push = -np.einsum("fij,fj->fi", stress, normals)
    own = V.dofmap.index_map.size_local
    nodes = comm.gather([places[:own], shift[:own], *(v[:own] for v in values)])
    skin = comm.gather([(places + shift)[ends], normals, push, places[ends]])
    if comm.rank == 0:
        every = [np.concatenate(part) for part in zip(*nodes, strict=True)]
        at, moved, strains, stresses, forces = every
        lines, normal, push, before = (np.concatenate(part) for part in zip(*skin, strict=True))
        draw(at + moved, strains, stresses, forces, lines, before, push)
        nearest = np.argmin(np.linalg.norm(before.mean(axis=1) - PRESSED, axis=1))
        outwards = push[nearest] @ normal[nearest]
        print(f"where it was pressed it pushes outwards with {outwards / 1e3:.0f} kPa")
        assert outwards > 0.9 * np.linalg.norm(push[nearest])
        # Beside the middle of the dent shear is added; nowhere is the skin pushed much harder.
        assert np.linalg.norm(push, axis=1).max() < 1.5 * outwards
        print(f"resultant {resultant:.1e}, moment {moment:.1e} (allowed {TOLERANCE:.0e})")
    assert max(resultant, moment) < TOLERANCE


def chosen(places, spacing):
    """One node in each square of a grid, so that the drawing is not crowded."""
    squares = np.floor(places / spacing).astype(int)
    return np.unique(squares, axis=0, return_index=True)[1]


def draw(places, strains, stresses, forces, lines, before, push):
    """Four pictures of the deformed duck, in millimetres; dashed as it was before."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.collections import LineCollection, PolyCollection
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11, 7.6), layout="constrained")
    FigureCanvasAgg(figure)
    panels = figure.subplots(2, 2).ravel()
    few = chosen(places, 4.5e-3)
    outline, old = (1e3 * ordered(one) for one in (lines, before))
    titles = (
        "strain E",
        "stress σ",
        "force per volume, div σ",
        "traction on the surroundings, −σ n",
    )
    for panel, title in zip(panels, titles, strict=True):
        panel.add_collection(
            PolyCollection([outline], facecolors=GREY, edgecolors="#6b5b2e", linewidths=1.2)
        )
        panel.plot(*old.T, "--", color="#999", linewidth=0.9, zorder=0)
        panel.plot(38, 69, "o", color="#333", markersize=5)
        panel.set_title(title)
        panel.set_aspect("equal")
        panel.set_axis_off()
        panel.set_xlim(-70, 78)
        panel.set_ylim(-12, 92)
    for panel, tensors in zip(panels, (strains, stresses), strict=False):
        crosses(panel, places[few], tensors[few].reshape(-1, 2, 2), LineCollection)
    panels[0].text(-68, 84, "red: longer, blue: shorter", fontsize=9, color="#555")
    panels[1].text(-68, 84, "red: pulled, blue: pressed", fontsize=9, color="#555")
    arrows(panels[2], places[few], forces[few], BLUE)
    arrows(panels[3], lines.mean(axis=1), push, RED)
    figure.savefig("duck_plane.png", dpi=130)


def ordered(lines):
    """The outline as one polygon of the facets, shape (n, 2, 2)."""
    keys = np.round(lines / 1e-9).astype(np.int64)
    follow = {}
    for i, (a, b) in enumerate(keys):
        follow.setdefault(tuple(a), []).append((i, 0))
        follow.setdefault(tuple(b), []).append((i, 1))
    result, facet, end = [], 0, 1
    for _ in range(len(lines)):
        result.append(lines[facet, end])
        (facet, end) = next(x for x in follow[tuple(keys[facet, end])] if x[0] != facet)
        end = 1 - end
    return np.array(result)


def crosses(panel, places, tensors, collection):
    """Principal values along their directions: lines through the places."""
    values, directions = np.linalg.eigh(tensors)
    seen = np.abs(values).max(axis=1) > 0.04 * np.abs(values).max()
    values, directions, places = values[seen], directions[seen], places[seen]
    scale = 7e-3 / np.abs(values).max()
    for k in range(2):
        arm = scale * values[:, k, None] * directions[:, :, k] / 2
        colours = [RED if value > 0 else BLUE for value in values[:, k]]
        ends = 1e3 * np.stack([places - arm, places + arm], axis=1)
        panel.add_collection(collection(ends, colors=colours, linewidths=1.6))


def arrows(panel, places, vectors, colour):
    """Arrows of which the longest has 14 mm; those that are hardly seen are left out."""
    size = np.linalg.norm(vectors, axis=1)
    seen = size > 0.02 * size.max()
    x, y = 1e3 * places[seen].T
    dx, dy = 14 / size.max() * vectors[seen].T
    panel.quiver(
        x, y, dx, dy, color=colour, angles="xy", scale_units="xy", scale=1, width=0.004, zorder=3
    )


if __name__ == "__main__":
    main()
