"""A grinding-force log as evidence: what it says of wheel, blade, flange and sensor, jointly with the arm."""
