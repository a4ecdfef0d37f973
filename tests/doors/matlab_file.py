"""`python -m tests.doors.matlab_file FILE`: an idss, as docs/own-models.md has MATLAB save it."""

from __future__ import annotations

import sys

import numpy as np
from scipy.io import savemat

if __name__ == "__main__":
    dt_s = 0.02
    pole = np.exp(-1.7 * dt_s)
    fields = {
        "A": [[pole]],
        "B": [[0.112 * (1.0 - pole)]],
        "C": [[1.0]],
        "D": [[0.0]],
        "Ts": dt_s,
        "InputName": np.array([["theta_in"]], dtype=object),
        "OutputName": np.array([["v_x"]], dtype=object),
        "InputUnit": np.array([["deg"]], dtype=object),
        "OutputUnit": np.array([["m/s"]], dtype=object),
    }
    savemat(sys.argv[1], fields)
