"""The compensator: cell, contact, model, optimal control, report, command lines."""

import os

# Matrices here are small and passes run side by side in processes: BLAS threads only fight for the cores (a contact of
# 75 cells took 1 s instead of 1 ms on a busy two-core machine). Must stand before NumPy is first imported.
for _variable in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_variable, "1")
