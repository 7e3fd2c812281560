"""Link-side encoders: the angle of a link against that of its motor through the gear (FORMATS, joints.csv)."""
