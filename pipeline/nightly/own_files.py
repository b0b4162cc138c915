"""What a night may replace in its output folder: what nights before it wrote."""

import os
from pathlib import Path

from pipeline.errors import NightlyError
from pipeline.nightly.index_page import INDEX_FILE, is_index
from pipeline.nightly.summary import LINES_FILE, SUMMARY_FILE, is_summary


def refuse_to_replace(output: Path) -> None:
    """Refuse an output folder with files that nights replace and that none of them wrote.

    Raises
    ------
    NightlyError
    """
    for name, is_own in ((INDEX_FILE, is_index), (SUMMARY_FILE, is_summary)):
        path = output / name
        if os.path.lexists(path) and not is_own(path):
            raise NightlyError(f"{path}: there is a file that no night wrote; use another output")
    lines = output / LINES_FILE
    if os.path.lexists(lines) and (lines.is_symlink() or not lines.is_file()):
        raise NightlyError(f"{lines}: expected a file of a night's, found a link or a folder")
