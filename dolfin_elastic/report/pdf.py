"""A page as PDF, printed by a Chromium that is installed."""

from __future__ import annotations

import os
import shutil
import subprocess
import tempfile
from pathlib import Path

from dolfin_elastic.core.errors import OutputError
from dolfin_elastic.core.files.regular import fresh

BROWSERS = ("chromium", "chromium-browser", "google-chrome-stable", "google-chrome")
_SECONDS = 120


def print_pdf(page: Path, pdf: Path) -> Path:
    """Prints a page on A4.

    Args:
        page: The HTML file, from `write_report`.
        pdf: The PDF file; an old one is overwritten.

    Returns:
        The PDF file.

    Raises:
        OutputError: There is no Chromium, or it prints nothing.
    """
    browser = next((program for name in BROWSERS if (program := shutil.which(name))), None)
    if browser is None:
        raise OutputError(
            f"no PDF: there is no Chromium here ({', '.join(BROWSERS)}); open {page} in a "
            "browser and print it into a file: the page is laid out for A4"
        )
    with tempfile.TemporaryDirectory(
        prefix="dolfin-elastic-", ignore_cleanup_errors=True
    ) as profile:
        printed, draft = Path(profile) / "report.pdf", pdf.with_name(f".{pdf.name}.part")
        command = [
            browser,
            "--headless=new",
            "--disable-gpu",
            "--no-first-run",
            "--disable-extensions",
            "--host-resolver-rules=MAP * ~NOTFOUND",  # the page loads nothing; nor does the browser
            f"--user-data-dir={profile}",
            "--no-pdf-header-footer",
            f"--print-to-pdf={printed}",
            *(["--no-sandbox"] if os.geteuid() == 0 else []),  # it has none for root
            page.resolve().as_uri(),
        ]
        try:
            done = subprocess.run(
                command, capture_output=True, timeout=_SECONDS, check=False, cwd=profile
            )
        except (OSError, subprocess.TimeoutExpired) as error:
            raise OutputError(f"no PDF: {browser} has failed: {error}") from None
        if done.returncode or not printed.is_file():
            last = done.stderr.decode(errors="replace").strip().splitlines()[-1:]
            raise OutputError(f"no PDF: {browser} has failed: {' '.join(last)}")
        try:
            shutil.copyfile(printed, fresh(draft))
            draft.replace(pdf)
        except OSError as error:
            raise OutputError(f"cannot write {pdf}: {error.strerror}") from None
    return pdf
