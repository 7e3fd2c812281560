"""Bundled cell and blade; the record of the blind checks' answers.

Here: where they lie. Not here: how they are read (ocp.model.cell, trajectories.blade).
"""

from pathlib import Path

CELL = Path(__file__).with_name("cell.toml")
BLADE = Path(__file__).with_name("blade.stl")
BLINDTEST_RECORD = Path(__file__).with_name("blindtest_record.jsonl")
