"""Wheel, blade, mount and force sensor of the virtual cell (docs/virtual_grinding.md).

Here: how hard blade and wheel press, and what the sensor shows. Not here: where the arm is without contact (twin/arm).
"""

from ocp.simulate.twin.contact.contact_instants import ContactMoments, ContactResult
from ocp.simulate.twin.contact.grinder import Grinder, make_grinder
from ocp.simulate.twin.contact.sensor import read_sensor
from ocp.simulate.twin.contact.table import Tables

__all__ = ["ContactMoments", "ContactResult", "Grinder", "Tables", "make_grinder", "read_sensor"]
