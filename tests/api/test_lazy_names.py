"""The interface is imported at once, a command's room when it is asked for."""

import subprocess
import sys

import pytest

import ocp.api


def test_importing_the_interface_imports_no_room():
    heavy = "ocp.plan.interface casadi matplotlib scipy pinocchio".split()
    told = f"import sys, ocp.api; print([name for name in {heavy} if name in sys.modules])"
    assert subprocess.run([sys.executable, "-c", told], capture_output=True, text=True, check=True).stdout.strip() == "[]"


def test_every_name_is_there_and_no_other():
    for name in ocp.api.__all__:
        assert getattr(ocp.api, name) is not None
    with pytest.raises(AttributeError, match="has no plam"):
        _ = ocp.api.plam
