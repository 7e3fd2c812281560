"""docs/tutorial.md word for word: `python -m tests.support.tutorial FOLDER [--pictures]` runs its commands in an empty folder,
holds what they say against what the page quotes, tells the seconds, and takes the page's pictures."""

import os
import re
import shlex
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path

from tests.support.browser import browser
from tests.support.house import ROOT

PAGE, PICTURES = ROOT / "docs" / "tutorial.md", ROOT / "docs" / "pictures"
SHOWN = {  # picture of the page: what it shows, height of the window
    "cell": ("cell_page/cell.html", 1180),
    "plan": ("plan/report.html", 1080),
    "rehearsal": ("run/rehearsal.html", 1180),
    "diagnosis": ("diagnosis/report.html", 1180),
}


@dataclass(frozen=True)
class Step:
    """A command, and parts of what it says in the order in which the page quotes them."""

    command: tuple[str, ...]
    quoted: tuple[str, ...]


def steps(page: str) -> list[Step]:
    """Commands of a page, each in a block of its own that begins with $; what follows there is quoted, .. for what is cut."""
    found = []
    for block in re.findall(r"```text\n(\$ grindplan .*?)```", page, re.DOTALL):
        command, _, said = block.partition("\n")
        parts = [" ".join(part.split()) for part in said.split(" .. ")]
        found.append(Step(tuple(shlex.split(command)[2:]), tuple(part.strip(" .") for part in parts if part.strip(" ."))))
    return found


def lacking(step: Step, said: str) -> list[str]:
    """What of a quotation is not said."""
    text = " ".join(said.split())
    return [part for part in step.quoted if part not in text]


def run(folder: Path) -> list[str]:
    """Run every step in `folder`; what was wrong, a sentence each."""
    wrong: list[str] = []
    for step in steps(PAGE.read_text(encoding="utf-8")):
        began = time.monotonic()
        call = [sys.executable, "-m", "ocp.grindplan", *step.command]
        ours = os.environ | {"PYTHONPATH": str(ROOT)}  # this checkout's, installed or not
        told = subprocess.run(call, cwd=folder, capture_output=True, text=True, env=ours, check=False)
        print(f"{time.monotonic() - began:7.1f} s  {' '.join(step.command)}", flush=True)  # noqa: T201
        if told.returncode != 0:
            wrong.append(f"{' '.join(step.command)}: exit {told.returncode}: {told.stderr.strip()[-300:]}")
            break
        wrong += [f"{' '.join(step.command)}: '{part}' is not in: {told.stdout}" for part in lacking(step, told.stdout)]
    return wrong


def take_pictures(folder: Path) -> None:
    """Pictures of the pages that the commands wrote."""
    PICTURES.mkdir(exist_ok=True)
    with browser() as page:
        for name, (file, height) in SHOWN.items():
            page.open(folder / file, 1280, height)
            time.sleep(1.0)
            (PICTURES / f"{name}.png").write_bytes(page.seen())


if __name__ == "__main__":
    place = Path(sys.argv[1])
    place.mkdir(parents=True, exist_ok=True)
    faults = run(place)
    if "--pictures" in sys.argv:
        take_pictures(place)
    sys.exit("\n".join(faults) or 0)
