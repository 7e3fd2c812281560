"""An STL made trustworthy, and the aerofoil found in it."""

from trajectories.blade.mesh import Blade
from trajectories.blade.reading import read_blade
from trajectories.blade.shape import AerofoilShape, find_shape

__all__ = ["AerofoilShape", "Blade", "find_shape", "read_blade"]
