"""What a case has in CSV files: curves and records over time, and branches that relax."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeVar

from dolfin_elastic.case.toml import key_text
from dolfin_elastic.core.errors import CaseError, InputError, all_errors, keyed
from dolfin_elastic.core.files.columns import CsvTable, is_number, read_csv
from dolfin_elastic.core.schema import Record
from dolfin_elastic.model.amplitude import Amplitude, CurveFile
from dolfin_elastic.model.records import RecordTable
from dolfin_elastic.model.relaxation import SUM_BELOW_ONE, SeriesFile, ViscousTerm

R = TypeVar("R", bound=Record)

CURVED = ("support", "load", "contact", "periodic")
"""Keys of a case whose tables, or whose lists' tables, may have a `curve` or records."""


def with_curves(case: R, folder: Path) -> R:
    """The same case, its curves and records read from their files. Not collective.

    Args:
        case: A record with the keys `CURVED`.
        folder: Folder that the paths are relative to.

    Raises:
        InputError: A file that cannot be read, or that has no such columns.
    """
    read: dict[str, Any] = {}
    for key in CURVED:
        found = getattr(case, key)
        if isinstance(found, list):
            rows = [_with_files(row, f"{key}[{i}]", folder) for i, row in enumerate(found)]
            if any(row is not old for row, old in zip(rows, found, strict=True)):
                read[key] = rows
        elif found is not None and (table := _with_files(found, key, folder)) is not found:
            read[key] = table
    return case.model_copy(update=read) if read else case


def has_curve_files(case: Record) -> bool:
    """Whether `with_curves` reads files.

    Args:
        case: A record with the keys `CURVED`.
    """
    curve = [getattr(case, key) for key in CURVED]
    rows = [row for table in curve for row in (table if isinstance(table, list) else [table])]
    return any(_unread(row) is not None or [*_unread_records(row)] for row in rows)


def _unread(row: object) -> Amplitude | None:
    """The curve of a table whose file is still to be read."""
    curve = getattr(row, "curve", None)
    is_unread = isinstance(curve, Amplitude) and curve.source is not None and not curve.rows
    return curve if is_unread else None


def _unread_records(row: object) -> Iterator[str]:
    """Keys of a table that hold records whose files are still to be read."""
    for key in type(row).model_fields if isinstance(row, Record) else ():
        value = getattr(row, key)
        parts = value if isinstance(value, list | tuple) else [value]
        if any(_is_unread(part) for part in parts):
            yield key


def _is_unread(value: object) -> bool:
    if not isinstance(value, Mapping) or "field" in value:  # one of a mesh: see `field_files`
        return False
    return "file" in value and not isinstance(value, RecordTable)


def _with_files(row: R, where: str, folder: Path) -> R:
    curve, read = _unread(row), dict[str, Any]()
    if curve is not None:
        assert curve.source is not None
        with _of_file(curve.source.file, f"{where}.curve"):
            read["curve"] = curve.with_rows(_columns(curve.source, folder / curve.source.file))
    for key in _unread_records(row):
        value = getattr(row, key)
        if isinstance(value, list | tuple):
            place = f"{where}.{key}[{{}}]"
            read[key] = [_with_rows(part, place.format(i), folder) for i, part in enumerate(value)]
        else:
            read[key] = _with_rows(value, f"{where}.{key}", folder)
    if not read:
        return row
    with keyed(where):  # made anew, for it has read the value
        return type(row)(**{key: getattr(row, key) for key in row.model_fields_set} | read)


def _with_rows(value: object, where: str, folder: Path) -> object:
    """A record with the rows of its file; anything else as it is."""
    if not _is_unread(value):
        return value
    assert isinstance(value, Mapping)
    result = RecordTable(value)
    source = CurveFile(*(str(value.get(key, "")) for key in ("file", "time", "value")))
    with _of_file(source.file, where):
        result.rows = _columns(source, folder / source.file)
    return result


@contextmanager
def _of_file(name: str, where: str) -> Iterator[None]:
    """Errors that are raised inside name a file and the key that refers to it."""
    try:
        yield
    except InputError as error:
        raise CaseError(f"{name}: {error.what}", where=where, expected=error.expected) from None


def _columns(source: CurveFile, path: Path) -> list[list[str]]:
    """Rows of time and value as texts, which may have units."""
    table = read_csv(path)
    at = [table.index(source.time, 0), table.index(source.value, 1)]
    rows = table.numbers(at)
    if not source.time + source.value:
        _refuse_commas(table)
    return [cells for _, cells in rows]


def _refuse_commas(table: CsvTable) -> None:
    """Refuses four unnamed columns of whole numbers: they may be two with decimal commas."""
    if table.mark != "," or table.head is not None:
        return
    whole = all(cell.lstrip("+-").isdigit() for _, row in table.rows for cell in row)
    if whole and all(len(row) == 4 for _, row in table.rows):
        line, row = table.rows[0]
        raise InputError(
            f"line {line} has 4 columns: are its commas decimal ones? {','.join(row)!r}",
            expected="decimal points; or name the columns by headings, and by time and value",
        )


# --- branches of materials that relax ---


def has_series_files(tables: Mapping[str, object]) -> bool:
    """Whether `with_series` reads files.

    Args:
        tables: Of a case, as they were written.
    """
    return any(True for _ in _series_files(tables))


def _series_files(
    tables: Mapping[str, object],
) -> Iterator[tuple[str, str, Mapping[str, object]]]:
    """Names of materials whose branches are in a file, with the key and the keys of the file."""
    materials = tables.get("materials")
    for name, row in materials.items() if isinstance(materials, Mapping) else ():
        for key in ("viscous", "prony") if isinstance(row, Mapping) else ():
            if isinstance(written := row.get(key), str | Mapping):
                yield name, key, {"file": written} if isinstance(written, str) else written


def with_series(tables: Mapping[str, object], folder: Path) -> dict[str, object]:
    """The tables of a case, the branches of its materials read from their files.

    Not collective.

    Args:
        folder: Folder that the paths are relative to.

    Raises:
        InputError: A file that cannot be read, that has no such columns, or no such branches.
    """
    result = dict(tables)
    with all_errors() as attempt:
        for name, key, written in _series_files(tables):
            materials = result["materials"]
            assert isinstance(materials, Mapping)
            row, where = materials[name], f"materials.{key_text(name)}.{key}"
            with attempt():
                with keyed(where):
                    source = SeriesFile(**written)
                default = "instantaneous" if key == "prony" else "long-term"
                sudden = row.get("viscous_constants", default) == "instantaneous"
                with _of_file(source.file, where):
                    series = _series(source, folder / source.file, sudden=sudden)
                result["materials"] = {**materials, name: {**row, key: series}}
    return result


def _series(source: SeriesFile, path: Path, *, sudden: bool) -> list[dict[str, float]]:
    """Branches as a material has them.

    Args:
        sudden: The ratios are those to the stress of a sudden strain, so that some is left.
    """
    table = read_csv(path)
    names = [
        given or next((name for name in (key, other) if name in (table.head or ())), key)
        for key, given, other in (("ratio", source.ratio, "g"), ("time", source.time, "tau"))
    ]
    result, ratios = [], 0.0
    for line, (ratio, time) in table.numbers([table.index(name, 0) for name in names]):
        bare = source.unit and is_number(time)
        try:
            term = ViscousTerm(ratio=ratio, time=f"{time} {source.unit}" if bare else time)
        except InputError as error:
            text = f"line {line}, column '{names[error.where == 'time']}': {error.what}"
            raise InputError(text, expected=error.expected) from None
        ratios += term.ratio
        if sudden and ratios >= 1:
            raise InputError(
                f"up to line {line} the ratios sum up to {ratios:.6g}: nothing would hold the "
                "shape for long",
                expected=SUM_BELOW_ONE,
            )
        result.append({"ratio": term.ratio, "time": term.time})
    return result
