"""Which tests run: the quick set, the rest, or all of them; on one rank, two and three.

Where the command line names files, all of their tests run, whatever set they belong to.  Else:

                   one rank                        n ranks
    quick set      what is not `long`, and of      one parameter of every third test of those that
                   each test QUICK parameters,     the rest runs on so many ranks, if it is neither
                   of a `sample(k)` k              `long` nor SLOW; on 3 of every sixth
    rest (--rest)  PLENTY parameters of each       MOST parameters of each test of the files that
                   test, but the quick set and     run on n ranks; where they run on 2 and on 3,
                   what is `spare`; which ones     one test there, the next here, `long` ones on 2;
                   follows from the week           of those on 2 the week takes half
    all (--all)    every test                      every test and parameter of these files that is
                                                   not ENDURING, on each number of ranks that they
                                                   run on
"""

from __future__ import annotations

import os
from collections import Counter, defaultdict
from collections.abc import Iterable
from pathlib import Path

import pytest
from mpi4py import MPI

from suite.turns import first_of, week

TESTS = Path(__file__).resolve().parent.parent

POINTS = {
    "case/decks/test_abaqus_decks.py",
    "case/decks/test_beside_calculix.py",
    "case/decks/test_compare.py",
    "case/decks/test_deck_equations.py",
    "case/decks/test_febio_decks.py",
    "case/decks/test_followers.py",
    "case/decks/test_nastran_decks.py",
    "case/decks/test_rigid_bodies.py",
    "case/reference/test_json_schema.py",
    "case/test_image_cases.py",
    "case/test_one_rank.py",
    "cli/test_cli.py",
    "cli/test_commands_made.py",
    "cli/test_console.py",
    "cli/test_full_disk.py",
    "cli/test_killed.py",
    "cli/test_stopped.py",
    "cli/test_streams.py",
    "cli/test_tools.py",
    "core/files/test_hdf5.py",
    "core/files/test_links.py",
    "core/files/test_xml.py",
    "core/test_errors.py",
    "core/test_formula.py",
    "core/test_help.py",
    "core/test_schema.py",
    "core/test_shapes.py",
    "core/test_shown.py",
    "core/test_units.py",
    "demos/test_demos.py",
    "hostile/test_current_folder.py",
    "hostile/test_faults_page.py",
    "hostile/test_fuzzed_cases.py",
    "hostile/test_gmsh.py",
    "hostile/test_petsc_options.py",
    "hostile/test_terminal.py",
    "mesh/test_components.py",
    "mesh/images/labels/test_nets.py",
    "mesh/images/test_images.py",
    "mesh/test_fill.py",
    "mesh/test_surfaces.py",
    "mesh/test_losses.py",
    "mesh/test_silent_losses.py",
    "model/materials/test_library.py",
    "model/materials/test_moduli.py",
    "model/materials/test_reference_energies.py",
    "model/materials/test_viscous.py",
    "model/point/test_material_point.py",
    "model/point/test_stable_range.py",
    "model/point/test_time_curves.py",
    "model/test_amplitude.py",
    "model/test_discrete_gradient.py",
    "model/test_kinematics.py",
    "problem/terms/test_barrier_package.py",
    "model/test_strength.py",
    "native/test_sanitisers.py",
    "notebook/test_notebooks.py",
    "report/test_report.py",
    "report/test_safety.py",
    "results/exports/test_exported_modes.py",
    "results/finished/test_plot.py",
    "results/scene/test_series.py",
    "solvers/dynamics/implicit/test_schemes.py",
    "strangers/test_strangers.py",
    "study/converge/test_extrapolation.py",
    "study/sweep/test_sweep_command.py",
    "study/sweep/test_sweep_settings.py",
    "study/gradient/test_gradient_command.py",
    "study/fit/test_fit.py",
    "study/fit/test_fit_input.py",
    "study/fit/test_fit_over_time.py",
    "study/identify/test_identify_input.py",
    "test_docs.py",
    "test_install.py",
    "test_layout.py",
    "test_packaging.py",
    "test_scaling_model.py",
    "test_seams.py",
    "test_tutorials.py",
    "test_turns.py",
    "verification/test_manufactured.py",
    "words/test_words.py",
}
"""Tests of numbers and texts, and of rates, in which ranks take no part, and of programs that start
ranks themselves: on one rank only."""
LAWS = {
    "case/check/test_check_damping.py",
    "case/check/test_check_report.py",
    "case/check/test_degree.py",
    "study/converge/test_converge.py",
    "study/gradient/test_functionals.py",
    "study/gradient/test_gradient.py",
    "mesh/test_selection.py",
    "model/materials/test_law_input.py",
    "model/materials/test_laws.py",
    "model/materials/test_user_energy.py",
    "problem/test_coefficients.py",
    "problem/test_dimension.py",
    "solvers/diagnostics/test_diagnose.py",
    "solvers/dynamics/explicit/test_impact.py",
    "solvers/dynamics/implicit/test_energy_momentum.py",
    "solvers/dynamics/implicit/test_implicit.py",
    "solvers/dynamics/implicit/test_incompressible_motion.py",
    "solvers/dynamics/test_energy_balance.py",
    "solvers/statics/test_arc_length.py",
    "solvers/statics/test_hard_cases.py",
    "verification/test_enclosed.py",
    "verification/test_linear.py",
}
"""Tests of every law, or of names, on bodies of a few cells, and of long paths whose solvers other
files try on several ranks: there in the rest only."""
REFERENCES = {
    "verification/test_bending.py",
    "verification/test_closed_forms.py",
    "verification/test_heart.py",
    "verification/test_layers.py",
    "verification/test_modes.py",
    "verification/test_motion.py",
    "verification/test_rubber.py",
    "verification/test_necking.py",
    "verification/test_tapered.py",
    "verification/test_taylor_bar.py",
    "verification/test_thick_plate.py",
    "verification/test_three_point_bending.py",
}
"""Published numbers, which ask how right the model is.  The parts that ranks share in them, curved
meshes, supports, loads, pressures and probes, have tests of their own; on one rank only, but for
the linear ones, which run on two so that reference cases as such do."""
SHARED = {
    "study/converge/test_converge.py",
    "study/gradient/test_gradient.py",
    "study/identify/test_identify.py",
    "study/identify/test_identify_field.py",
    "study/sweep/test_sweep.py",
    "case/test_node_loads.py",
    "case/test_restart.py",
    "case/test_several.py",
    "case/test_motion_start.py",
    "solvers/dynamics/test_preload.py",
    "hostile/test_generated.py",
    "mesh/images/labels/test_label_body.py",
    "mesh/images/test_image_fields.py",
    "mesh/test_arrays.py",
    "mesh/test_edges_and_points.py",
    "mesh/test_parts.py",
    "mesh/test_read.py",
    "mesh/test_refine.py",
    "mesh/test_sent_names.py",
    "mesh/test_shared_faults.py",
    "model/loads/test_bearing.py",
    "model/loads/test_loads.py",
    "model/loads/test_pressure.py",
    "model/loads/test_remote_force.py",
    "model/supports/test_supports.py",
    "notebook/test_notebook_views.py",
    "problem/terms/test_at_points.py",
    "problem/terms/test_barrier.py",
    "problem/terms/test_body_contact.py",
    "problem/terms/test_bolts.py",
    "problem/terms/test_contact.py",
    "problem/terms/test_contact_step.py",
    "problem/terms/test_edges_points.py",
    "problem/terms/test_friction.py",
    "problem/terms/test_loaded_obstacle.py",
    "problem/terms/test_moving_mass.py",
    "problem/terms/test_rigid_mesh.py",
    "problem/terms/test_rolling.py",
    "problem/terms/test_sharp_obstacles.py",
    "problem/terms/test_turning.py",
    "problem/terms/test_vertex_contact.py",
    "problem/test_connected_bodies.py",
    "problem/test_dealt_out.py",
    "problem/test_mesh_fields.py",
    "case/test_field_files.py",
    "problem/test_mixed.py",
    "problem/test_parameters.py",
    "problem/constraints/periodic/test_periodic.py",
    "problem/test_point_mass.py",
    "problem/test_positions.py",
    "problem/test_problem.py",
    "results/checkpoint/test_checkpoints.py",
    "results/exports/test_exports.py",
    "results/finished/test_finished.py",
    "results/recovery/test_motion_peaks.py",
    "results/test_axes.py",
    "results/test_body_fields.py",
    "results/test_probes.py",
    "results/test_results.py",
    "results/test_scattered.py",
    "results/writers/test_formats.py",
    "solvers/assembly/test_node_blocks.py",
    "solvers/assembly/test_scalar_mass.py",
    "solvers/linear/test_surface_means.py",
    "solvers/audit/test_audit.py",
    "solvers/dynamics/explicit/test_explicit.py",
    "solvers/dynamics/explicit/test_explicit_audit.py",
    "solvers/dynamics/explicit/test_explicit_damping.py",
    "solvers/dynamics/explicit/test_explicit_loop.py",
    "solvers/dynamics/explicit/test_impact.py",
    "solvers/dynamics/explicit/test_monitor.py",
    "solvers/dynamics/explicit/test_stable_step.py",
    "solvers/dynamics/implicit/test_incompressible_motion.py",
    "solvers/dynamics/test_base_motion.py",
    "solvers/dynamics/test_dynamics.py",
    "solvers/dynamics/test_initial_conditions.py",
    "solvers/diagnostics/test_rigid_body.py",
    "solvers/eigen/test_lobpcg.py",
    "solvers/eigen/test_modal.py",
    "solvers/nonlinear/test_scalars.py",
    "solvers/statics/test_statics.py",
    "verification/test_patch.py",
    "verification/test_rank_agreement.py",
    "verification/test_evolution.py",
    "verification/test_own_history.py",
    "verification/test_plasticity.py",
    "verification/test_relaxation.py",
    "verification/test_tetrahedron.py",
}
"""Tests of what ranks share and agree upon: what three ranks can show beyond two, ranks without a
cell or a facet of a part, it shows here."""

SLOW = ("picture", "colour", "adaptive", "second_order", "no_cycles", "block_bounces")
"""In names of tests of drawings, which one rank makes, and of many small steps: such tests take
long where ranks wait for each other, and belong to the rest there."""
ENDURING = ("fifty_periods", "test_second_order", "to_second_order")
"""In names of tests of orders and periods in time, thousands of small steps, in which ranks
that wait for each other take minutes each: on one rank only; the steps are the same on several."""
QUICK = 1
"""Parameters of each test in the quick set, unless it says so itself."""
PLENTY, PLENTY_OF_LONG = 3, 1
"""Parameters of each test on one rank in the rest, and of a `long` one, except of TEXTS: all of
them by --all."""
TEXTS = {
    "case/reference/test_json_schema.py",
    "case/test_case.py",
    "core/files/test_links.py",
    "core/test_help.py",
    "mesh/test_abaqus.py",
    "model/materials/test_library.py",
    "model/materials/test_moduli.py",
    "results/test_verdict.py",
    "test_readme.py",
}
"""Tests of pages, messages and words, each of which takes milliseconds: all run in the rest."""
MOST = 1
"""Parameters of each test on several ranks: longer lists are of laws, bodies and words, in which
ranks take no part; they take turns, and all run by --all."""


def runs_on(file: str, ranks: int) -> bool:
    """Whether a file has anything to show on so many ranks."""
    if ranks == 1:
        return True
    return file in SHARED if ranks > 2 else file not in POINTS | REFERENCES


def pytest_addoption(parser: pytest.Parser) -> None:
    """Options that choose a set."""
    group = parser.getgroup("suite")
    group.addoption("--all", action="store_true", help="every test, not only the quick set")
    group.addoption("--rest", action="store_true", help="what the quick set leaves out")
    group.addoption("--ranks", default="1,2,3", help="numbers of ranks to test on: 1,2,3")
    group.addoption(
        "--turn",
        metavar="WORD",
        help="which parameters of long lists the rest takes; by default the week says so",
    )
    group.addoption(
        "--variants",
        type=int,
        metavar="N",
        help="at most N of the parameters of each test",
    )


def pytest_configure(config: pytest.Config) -> None:
    """Markers of the quick set."""
    for line in (
        "long: takes long; it does not belong to the quick set",
        "sample(k): of its parameters k belong to the quick set",
        "spare: others show the same in less time; it runs by --all and where its file is named",
    ):
        config.addinivalue_line("markers", line)


def whole(config: pytest.Config) -> bool:
    """Whether the command line names no files."""
    return config.args_source is pytest.Config.ArgsSource.TESTPATHS


def asked(config: pytest.Config) -> list[int]:
    """The numbers of ranks to test on."""
    return [int(word) for word in config.getoption("ranks").split(",")]


def alone(config: pytest.Config) -> bool:
    """Whether this process is neither a worker of pytest-xdist nor one rank of several."""
    return MPI.COMM_WORLD.size == 1 and "PYTEST_XDIST_WORKER" not in os.environ


@pytest.hookimpl(tryfirst=True)
def pytest_cmdline_main(config: pytest.Config) -> None:
    """Spreads the tests on one rank over the cores, unless the command line says how."""
    if config.getoption("turn") is None:  # before others start, whom it is handed on to
        config.option.turn = week() if config.getoption("rest") else ""
    many = whole(config) and alone(config) and 1 in asked(config)
    if many and config.getoption("numprocesses", 0) is None:
        config.option.numprocesses = len(os.sched_getaffinity(0))
        config.option.dist = "worksteal"


def pytest_report_header(config: pytest.Config) -> str | None:
    """How to repeat the choice."""
    turn = config.getoption("turn")
    return f"parameters of long lists: --turn={turn}" if turn else None


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    """Files that do not run on so many ranks are not read there, which took each rank seconds."""
    if whole(config) and collection_path.suffix == ".py" and MPI.COMM_WORLD.size > 1:
        file = collection_path.relative_to(TESTS).as_posix()
        return None if runs_on(file, MPI.COMM_WORLD.size) else True
    return None


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Leaves the tests of the chosen set, and lets those that take longest begin first."""
    items.sort(key=lambda item: item.get_closest_marker("long") is None)
    mine, ranks = items, MPI.COMM_WORLD.size
    if whole(config):
        mine = [item for item in mine if ranks in asked(config) and runs_on(_file(item), ranks)]
        if ranks > 1:
            mine = [item for item in mine if not any(word in item.name for word in ENDURING)]
        if not config.getoption("all"):
            mine = _quick_or_rest(config, mine)
    if most := config.getoption("variants"):
        mine = [item for group in _alike(mine) for item in _spread(group, most)]
    taken = set(map(id, mine))
    config.hook.pytest_deselected(items=[item for item in items if id(item) not in taken])
    items[:] = mine


def _quick_or_rest(config: pytest.Config, items: list[pytest.Item]) -> list[pytest.Item]:
    """The quick set, which is always the same; or the rest, of which other parameters take turns.

    Args:
        items: What runs on so many ranks.
    """
    ranks, turn = MPI.COMM_WORLD.size, config.getoption("turn")

    def some(turn: str) -> list[pytest.Item]:
        chosen = _on_ranks(items, ranks, turn) if ranks > 1 else items
        chosen = [item for item in chosen if item.get_closest_marker("spare") is None]
        if ranks > 1:
            return chosen
        return [item for group in _alike(chosen) for item in _plenty(group, turn)]

    quick = _quick(some(""), ranks)
    if not config.getoption("rest"):
        return quick
    those = set(map(id, quick))
    return [item for item in some(turn) if id(item) not in those]


def _quick(items: Iterable[pytest.Item], ranks: int) -> list[pytest.Item]:
    short = [item for item in items if item.get_closest_marker("long") is None]
    if ranks > 1:
        short = [item for item in short if _file(item) not in LAWS]
        short = [item for item in short if not any(word in item.name for word in SLOW)]
    found = []
    seen: Counter[str] = Counter()
    for group in _alike(short):
        file = _file(group[0])
        seen[file] += 1
        # Three ranks on two cores take as long for every sixth test as two for every third one.
        if (ranks == 2 and seen[file] % 3) or (ranks == 3 and seen[file] % 6 != 1):
            continue
        found += _spread(group, 1 if ranks > 1 else _sample(group[0]))
    return found


def _on_ranks(items: list[pytest.Item], ranks: int, turn: str) -> list[pytest.Item]:
    """The tests for so many of several ranks: those of a file on two and on three take turns.

    Long ones run on two alone, which three ranks on two cores would take twice as long for.  Half
    of those on two have their turn: all of them take nearly as long as all that runs on one.

    Args:
        turn: See `_spread`; empty: all have it.
    """
    found: set[int] = set()
    seen: Counter[str] = Counter()
    for group in _alike(items):
        file = _file(group[0])
        seen[file] += 1
        if turn and ranks == 2 and seen[file] // 2 % 2 != first_of(turn, "two ranks", 2):
            continue
        on_three = file in SHARED and seen[file] % 2
        mine = [
            item
            for item in group
            if (on_three and item.get_closest_marker("long") is None) == (ranks > 2)
        ]
        found |= set(map(id, _spread(mine, MOST, turn)))
    return [item for item in items if id(item) in found]


def _alike(items: Iterable[pytest.Item]) -> Iterable[list[pytest.Item]]:
    """The parameters of each test."""
    groups = defaultdict(list)
    for item in items:
        groups[item.nodeid.partition("[")[0]].append(item)
    return groups.values()


def _spread(group: list[pytest.Item], most: int, turn: str = "") -> list[pytest.Item]:
    """So many of one test's parameters: each time the one whose values were taken least before.

    So of laws in two and three dimensions both dimensions are among them.

    Args:
        turn: Says which one is the first of them, and which come before equal ones; empty: as
            they stand.
    """
    if len(group) <= most:
        return group
    first = first_of(turn, group[0].nodeid.partition("[")[0], len(group))
    group = [*group[first:], *group[:first]]
    chosen = set(map(id, _least_alike(group, most)))
    return [item for item in group if id(item) in chosen]


def _least_alike(group: list[pytest.Item], most: int) -> list[pytest.Item]:
    taken: list[int] = []
    times: Counter[tuple[str, str]] = Counter()
    values = [_values(item) for item in group]
    while len(taken) < most:
        left = [i for i in range(len(group)) if i not in taken]
        taken.append(min(left, key=lambda i: sum(times[value] for value in values[i])))
        times.update(values[taken[-1]])
    return [group[i] for i in taken]


def _plenty(group: list[pytest.Item], turn: str) -> list[pytest.Item]:
    if _file(group[0]) in TEXTS:
        return group
    if group[0].get_closest_marker("long"):
        return _spread(group, PLENTY_OF_LONG, turn)
    return _spread(group, max(PLENTY, _sample(group[0])), turn)


def _sample(item: pytest.Item) -> int:
    """How many of a test's parameters belong to the quick set."""
    sample = item.get_closest_marker("sample")
    return int(sample.args[0]) if sample else QUICK


def _values(item: pytest.Item) -> list[tuple[str, str]]:
    callspec = getattr(item, "callspec", None)
    return [(name, repr(value)) for name, value in callspec.params.items()] if callspec else []


def _file(item: pytest.Item) -> str:
    return item.path.relative_to(TESTS).as_posix()


def pytest_sessionstart() -> None:
    """A file that has moved is to be noticed here."""
    if missing := [
        f for f in POINTS | LAWS | REFERENCES | SHARED | TEXTS if not (TESTS / f).exists()
    ]:
        raise pytest.UsageError(
            f"tests/suite/selection.py names files that are not there: {missing}"
        )
