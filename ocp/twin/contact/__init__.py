"""Wheel, blade, mount and force sensor of the virtual cell (docs/virtual_grinding.md)."""

from ocp.twin.contact.grinder import Grinder, make_grinder
from ocp.twin.contact.moments import ContactMoments, ContactResult
from ocp.twin.contact.sensor import read_sensor
from ocp.twin.contact.table import Tables

__all__ = ["ContactMoments", "ContactResult", "Grinder", "Tables", "make_grinder", "read_sensor"]
