"""Licences of what `pip install .` brings: `python -m tests.support.third_party` writes THIRD_PARTY.md from what is installed."""

import re
import tomllib
from importlib.metadata import Distribution, PackageNotFoundError, distribution

from packaging.requirements import Requirement

from tests.support.house import ROOT

PAGE = ROOT / "THIRD_PARTY.md"
GCC = "libgfortran (GPL-3.0 with GCC's exception), libquadmath (LGPL-2.1-or-later)"
# Where a package's metadata name no licence, and what its wheel carries of another licence than its own.
KNOWN = {"casadi": "LGPL-3.0-or-later", "netgen-mesher": "LGPL-2.1-only", "pytetwild": "MPL-2.0", "cmeel-qhull": "Qhull"}
HOLDS = {
    "casadi": "Ipopt (EPL-2.0), MUMPS (CeCILL-C), OpenBLAS (BSD) and others",
    "netgen-mesher": "Open CASCADE parts through netgen-occt (LGPL-2.1 with exception)",
    "typst": "crates under MIT, Apache-2.0 and BSD; fonts that are not used (OFL-1.1, GUST, Bitstream Vera)",
    "pytetwild": "GMP (LGPL-3.0-or-later or GPL-2.0-or-later), libgomp (GPL-3.0 with GCC's exception)",
    "numpy": f"OpenBLAS (BSD), {GCC}",
    "scipy": f"OpenBLAS (BSD), {GCC}",
}


def needed() -> dict[str, Distribution]:
    """Distributions by name that the package needs, and those that they need, as installed here."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    left, found = [Requirement(r) for r in project["dependencies"]], {}
    while left:
        one = left.pop()
        name = re.sub(r"[-_.]+", "-", one.name).lower()
        if name in found or (one.marker is not None and not one.marker.evaluate({"extra": ""})):
            continue
        try:
            found[name] = distribution(one.name)
        except PackageNotFoundError:
            continue
        left += [Requirement(r) for r in found[name].requires or ()]
    return dict(sorted(found.items()))


def licence(name: str, one: Distribution) -> str:
    """As its metadata say it, and what is bundled."""
    meta = one.metadata
    told = meta.get("License-Expression") or ""
    classifiers = [c.rsplit(" :: ", 1)[-1] for c in meta.get_all("Classifier") or () if c.startswith("License :: ")]
    told = told or ", ".join(c for c in classifiers if c != "OSI Approved")
    text = (meta.get("License") or "").strip()
    own = KNOWN.get(name) or told or (text.splitlines()[0][:60] if text else "not stated")
    return f"{own}; its wheel holds {HOLDS[name]}" if name in HOLDS else own


def page() -> str:
    rows = ["| package | version here | licence |", "|---|---|---|"]
    rows += [f"| {name} | {one.version} | {licence(name, one)} |" for name, one in needed().items()]
    return HEAD + "\n".join(rows) + "\n"


HEAD = """# Licences of what is installed

`pip install .` brings these packages; nothing of them is copied into this repository. Made from their own metadata by
`python -m tests.support.third_party`.

What some of them ask of somebody who hands the installed software on (ask your lawyer, not this page):

* **LGPL** (casadi, netgen-mesher and its Open CASCADE, GMP in pytetwild, libquadmath in numpy and scipy): their licence text goes
  along, and whoever gets the software must be able to put another build of the library in its place. Installed as wheels beside
  our Python files that is so.
* **MPL** (pytetwild): its own files stay under the MPL, with their source offered; ours are not touched by it.
* **EPL, CeCILL-C** (Ipopt and MUMPS inside casadi's wheel): their notices go along.
* The others (BSD, MIT, Apache, PSF): notices go along.

"""

if __name__ == "__main__":
    PAGE.write_text(page())
