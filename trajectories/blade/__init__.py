"""An STL made trustworthy, and the aerofoil found in it.

Here: reading and mending the mesh, span, sections and edges, a smooth surface for each side, what of it may be ground.
Not here: the passes laid on it (trajectories.passes); how the blade bends (ocp.contact.blade).
"""

from trajectories.blade.axis import NamedAerofoil
from trajectories.blade.mesh import Blade
from trajectories.blade.reading import read_blade
from trajectories.blade.shape import AerofoilShape, find_shape

__all__ = ["AerofoilShape", "Blade", "NamedAerofoil", "find_shape", "read_blade"]
