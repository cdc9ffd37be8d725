"""The formula language: what it reads, what it refuses, and numpy against UFL."""

from __future__ import annotations

import math
import pickle

import basix.ufl
import numpy as np
import pytest
import ufl
from hypothesis import example, given, settings
from hypothesis import strategies as st

from dolfin_elastic.core.compat import interpolation_points
from dolfin_elastic.core.errors import FormulaError
from dolfin_elastic.core.formula import Formula
from dolfin_elastic.core.formula_functions import FUNCTIONS

XYZT = ("x", "y", "z", "t")


def value(text: str, **names: float) -> float:
    """Reads and evaluates."""
    return float(Formula.parse(text, allowed=names).evaluate(**names))


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("1 + 2*3", 7.0),
        ("2^3^2", 512.0),
        ("2**3", 8.0),
        ("-2^2", -4.0),
        ("2^-1", 0.5),
        ("(1 + 2)*3", 9.0),
        ("7/2", 3.5),
        (".5 + 5.", 5.5),
        ("007", 7.0),
        ("1e-3", 1e-3),
        ("x^2 + 1", 10.0),
        ("pi", math.pi),
        ("ln(e)", 1.0),
        ("log(e)", 1.0),
        ("log10(100)", 2.0),
        ("atan2(1, 1)", math.pi / 4),
        ("min(3, 1, 2)", 1.0),
        ("max(1, x)", 3.0),
        ("abs(-x)", 3.0),
        ("sign(-x)", -1.0),
        ("sign(0)", 0.0),
        ("heaviside(0)", 1.0),
        ("heaviside(-1)", 0.0),
        ("ramp(0.3)", 0.3),
        ("ramp(7)", 1.0),
        ("smoothstep(0.5)", 0.5),
        ("smoothstep(2)", 1.0),
        ("where(x > 2, 1, 0)", 1.0),
        ("where(x <= 2, 1, 0)", 0.0),
        ("  +x ", 3.0),
        ("--x", 3.0),
        ("where(1 < 2, x, 1/0)", 3.0),
        ("x\n+ 1", 4.0),
        ("10 - 4 - 3", 3.0),
        ("8/4/2", 1.0),
    ],
)
def test_value(text: str, expected: float) -> None:
    """Operators bind as in a textbook."""
    assert value(text, x=3.0) == pytest.approx(expected, rel=1e-15)


@pytest.mark.parametrize("terms", [0, 1, 9, 30])
def test_a_long_formula_is_shown_in_part(terms: int) -> None:
    """Seventy characters about the fault fit a terminal, with the caret under it."""
    with pytest.raises(FormulaError) as caught:
        Formula.parse("1234 + " * terms + "abc" + " + 1234" * 30, allowed=XYZT)
    shown, caret = str(caught.value).splitlines()[-2:]
    assert shown[caret.index("^") :].startswith("abc")
    assert len(shown) == 4 + 70


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "the formula is empty\n    \n    ^"),
        ("0.1*x*tt", "unknown name 'tt'; did you mean 't'?\n    0.1*x*tt\n          ^"),
        ("q", "unknown name 'q'; known: e, pi, t, x, y, z\n    q\n    ^"),
        ("2x", "an operator is missing; a product is written a*b\n    2x\n     ^"),
        ("2 (x)", "an operator is missing; a product is written a*b\n    2 (x)\n      ^"),
        ("x +", "a value is missing at the end\n    x +\n       ^"),
        ("x + * y", "a value is missing before '*'\n    x + * y\n        ^"),
        ("x // y", "a value is missing before '/'\n    x // y\n       ^"),
        ("(x", "this parenthesis is never closed; add its )\n    (x\n    ^"),
        ("x)", "this parenthesis was never opened\n    x)\n     ^"),
        ("sin()", "a value is missing before ')'\n    sin()\n        ^"),
        ("sin", "'sin' is a function; write sin(...)\n    sin\n    ^"),
        ("sni(x)", "unknown function 'sni'; did you mean 'sin'?\n    sni(x)\n    ^"),
        ("coss(2)", "unknown function 'coss'; did you mean 'cos'?\n    coss(2)\n    ^"),
        ("x(2)", "'x' is not a function; write x*(...)\n    x(2)\n    ^"),
        ("atan2(x)", "atan2 takes 2 arguments, 1 given\n    atan2(x)\n    ^"),
        ("min(x)", "min takes 2 or more arguments, 1 given\n    min(x)\n    ^"),
        ("sin(x, y)", "sin takes 1 argument, 2 given\n    sin(x, y)\n    ^"),
        (
            "0,5",
            "a comma stands only between the arguments of a function; "
            "decimals are written 0.5\n    0,5\n     ^",
        ),
        ("x[0]", "unexpected '['; the coordinates are x, y, z\n    x[0]\n     ^"),
        ("x == 1", "unexpected '='; comparisons are < <= > >=\n    x == 1\n      ^"),
        ("__import__('os')", "unexpected '''\n    __import__('os')\n               ^"),
        ("x < 1", "a comparison is no number; use where(a < b, c, d)\n    x < 1\n    ^"),
        (
            "1 + (x < 1)",
            "a comparison is no number; use where(a < b, c, d)\n    1 + (x < 1)\n         ^",
        ),
        ("0 < x < 1", "comparisons cannot be chained; use where() twice\n    0 < x < 1\n    ^"),
        (
            "where(x, 1, 2)",
            "where() starts with a comparison; where(a < b, c, d)\n    where(x, 1, 2)\n          ^",
        ),
        (
            "x if x > 0 else y",
            "an operator is missing; a product is written a*b\n    x if x > 0 else y\n      ^",
        ),
        ("1e999*x", "this number is too large\n    1e999*x\n    ^"),
        ("1/0", "'1/0' is infinite"),
        ("sqrt(-1)", "'sqrt(-1)' is not a real number"),
        ("9**9**9", "'9**9**9' is infinite"),
        ("(-8)^(1/3)", "'(-8)^(1/3)' is not a real number"),
        ("x" * 1001, "a formula of 1001 characters is too long; at most 1000"),
        (
            "(" * 300 + "x" + ")" * 300,
            "the formula is nested too deeply; at most 100 operations deep",
        ),
        ("+".join(["x"] * 400), "the formula is nested too deeply; at most 100 operations deep"),
        ("-" * 900 + "x", "the formula is nested too deeply; at most 100 operations deep"),
    ],
)
def test_refused(text: str, message: str) -> None:
    """Every fault has its own words and a caret."""
    with pytest.raises(FormulaError) as caught:
        Formula.parse(text, allowed=XYZT)
    assert str(caught.value) == message


def test_scalar_that_is_not_finite_names_the_point() -> None:
    """A float has to be finite; arrays are for the caller to judge."""
    formula = Formula.parse("1/x", allowed=XYZT)
    with pytest.raises(FormulaError, match="'1/x' is infinite at x = 0"):
        formula.evaluate(x=0.0, t=1.0)
    assert np.isinf(formula.evaluate(x=np.zeros(2))).all()
    with pytest.raises(FormulaError, match="a part of 'x/0' is not finite"):
        Formula.parse("x/0", allowed=XYZT).ufl(x=_point()[0])


def test_result_has_the_common_shape() -> None:
    """Floats give a float; arrays an array of their shape, whatever the formula uses."""
    formula = Formula.parse("2*t", allowed=XYZT)
    assert type(formula.evaluate(t=1.0)) is float
    assert type(formula.ufl(t=1.0)) is float
    assert formula.evaluate(t=1.0, x=np.zeros((3, 2))).tolist() == [[2.0, 2.0]] * 3
    assert formula.names == {"t"}


def test_allowed_names_win_and_may_be_keywords() -> None:
    """`e` and `lambda` are fine names where the place allows them."""
    assert value("e + 1", e=2.0) == 3.0
    assert value("2*lambda", **{"lambda": 4.0}) == 8.0


def test_pickles() -> None:
    """Formulas travel between ranks inside a case."""
    formula = pickle.loads(pickle.dumps(Formula.parse("sin(x)", allowed=XYZT)))
    assert formula == Formula.parse("sin(x)", allowed=XYZT)
    assert formula.evaluate(x=0.5) == math.sin(0.5)


@settings(max_examples=400, deadline=None, derandomize=True)
@given(
    st.text(max_size=60) | st.text(alphabet="xyt0123.e+-*/^()<>=, sinwhere_\n\0\u00b5", max_size=40)
)
@example("9" * 400)
@example("2^2^2^2^2^2^2")
@example("\0")
@example("\ud800")
@example("e\u0301")
def test_any_text_parses_or_is_refused(text: str) -> None:
    """Nothing but FormulaError comes out, and the formula can be evaluated."""
    try:
        formula = Formula.parse(text, allowed=XYZT)
    except FormulaError:
        return
    formula.evaluate(**dict.fromkeys(XYZT, np.array([0.5, -1.0])))


def _point() -> ufl.SpatialCoordinate:
    cell = basix.ufl.element("Lagrange", "tetrahedron", 1, shape=(3,))
    return ufl.SpatialCoordinate(ufl.Mesh(cell))


def _texts() -> st.SearchStrategy[str]:
    """Well-formed formulas in x and y."""
    unary = sorted(name for name, op in FUNCTIONS.items() if op.fewest == op.most == 1)
    atoms = st.sampled_from(["x", "y", "2", "0.5", "pi", "1e-3"])

    def grow(inner: st.SearchStrategy[str]) -> st.SearchStrategy[str]:
        two = st.tuples(inner, inner)
        return st.one_of(
            st.tuples(st.sampled_from(unary), inner).map(lambda p: f"{p[0]}({p[1]})"),
            st.tuples(st.sampled_from("+-*/^"), two).map(lambda p: f"({p[1][0]} {p[0]} {p[1][1]})"),
            st.tuples(st.sampled_from(["min", "max", "atan2"]), two).map(
                lambda p: f"{p[0]}({p[1][0]}, {p[1][1]})"
            ),
            st.tuples(st.sampled_from(["<", "<=", ">", ">="]), inner, inner, two).map(
                lambda p: f"where({p[1]} {p[0]} {p[2]}, {p[3][0]}, {p[3][1]})"
            ),
            inner.map(lambda a: f"-{a}"),
        )

    return st.recursive(atoms, grow, max_leaves=8)


@pytest.mark.filterwarnings("ignore:Value error in evaluation")
@settings(max_examples=300, deadline=None, derandomize=True)
@given(_texts(), st.floats(0.1, 2.0), st.floats(-2.0, -0.1))
def test_numpy_and_ufl_agree(text: str, x: float, y: float) -> None:
    """The two halves of the table say the same, where the value is finite."""
    X = _point()
    try:
        formula = Formula.parse(text, allowed=XYZT)
        number = formula.evaluate(x=x, y=y)
        symbolic = formula.ufl(x=X[0], y=X[1])
        at_point = symbolic if isinstance(symbolic, float) else symbolic((x, y, 0.0))
    except (FormulaError, ArithmeticError, ValueError):
        return  # not finite on the way: Python's math raises where numpy gives nan
    except TypeError as error:
        if "complex" in str(error):  # a negative number to a broken power, compared by Python
            return
        raise
    if isinstance(at_point, complex) or abs(number) > 1e100:
        return
    assert at_point == pytest.approx(number, rel=1e-9, abs=1e-12)


@pytest.mark.sample(12)
@pytest.mark.parametrize("name", sorted(FUNCTIONS))
def test_compiled_code_agrees(name: str) -> None:
    """What DOLFINx makes of each function, at points that sit on the corners too."""
    from dolfinx import fem, mesh
    from mpi4py import MPI

    calls = {
        "where": "where(x < 0.5, x, y - 2)",
        "atan2": "atan2(y - 0.5, x - 0.25)",
        "min": "min(x, y, 0.3)",
        "max": "max(x, y, 0.3)",
        "asin": "asin(x/2)",
        "acos": "acos(x/2)",
        "ln": "ln(x + 1)",
        "log": "log(x + 1)",
        "log10": "log10(x + 1)",
        "sqrt": "sqrt(x + 1)",
    }
    formula = Formula.parse(calls.get(name, f"{name}(2*x - 1)"), allowed=XYZT)
    square = mesh.create_unit_square(MPI.COMM_SELF, 2, 2)
    space = fem.functionspace(square, ("Lagrange", 2))
    X = ufl.SpatialCoordinate(square)
    u = fem.Function(space)
    u.interpolate(fem.Expression(formula.ufl(x=X[0], y=X[1]), interpolation_points(space.element)))
    x, y, _ = space.tabulate_dof_coordinates().T
    assert np.allclose(u.x.array, formula.evaluate(x=x, y=y), rtol=1e-12, atol=1e-14)
