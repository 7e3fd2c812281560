"""Published campaigns of real robots as data set folders: UR5, UR10, KR 300.

Here: how their files are read. Not here: what is found in them (docs/diagnosis_real.md).
"""
