"""A shell that completes a command line, by the protocol of argcomplete."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path


def completions(line: str, folder: Path, **environment: str) -> tuple[set[str], str]:
    """Returns the completions of a line with the cursor at its end, and all that is printed besides; names are cached in ``folder``."""
    answer = folder / "completions.txt"
    answer.write_text("")
    variables = {
        "_ARGCOMPLETE": "1",
        "_ARGCOMPLETE_IFS": "\n",
        "_ARGCOMPLETE_STDOUT_FILENAME": str(answer),
        "_ARGCOMPLETE_SUPPRESS_SPACE": "1",
        "COMP_LINE": line,
        "COMP_POINT": str(len(line)),
        "XDG_CACHE_HOME": str(folder / "cache"),
    }
    code = "from gibson_sim.cli.main import main; main()"
    done = subprocess.run(
        [sys.executable, "-c", code],
        cwd=folder,
        env={**os.environ, **variables, **environment},
        capture_output=True,
        text=True,
        check=False,
    )
    return set(answer.read_text().split()), done.stdout + done.stderr
