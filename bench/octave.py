"""Octave with its control package, as a peer: a script in, the numbers that it prints out."""

from __future__ import annotations

import os
import shutil
import subprocess
import tempfile
from pathlib import Path

from flysid.dataset import FloatArray

PROLOGUE = """1;
function mb = peak(), s = fileread('/proc/self/status'); t = regexp(s, 'VmHWM:\\s*(\\d+)', 'tokens');
  mb = str2double(t{1}{1}) / 1024; endfunction
function show(m), [n, d] = tfdata(m); ny = rows(n); for i = 1:ny, printf('%.17g ', d{i, 1}(2:end));
  for j = 1:columns(n) - ny, printf('%.17g ', n{i, j}); endfor, endfor, endfunction
pkg load control; load('{data}'); d = iddata(y, u, 0.01);
"""
ARX = "show(arx(d, 'na', {na}, 'nb', {nb}));"
"""Prints a1.., then b1.. of every input, output after output (each output regresses on its own past)."""
TIMED = "before = peak(); t = cputime(); {work}; printf('%.6f %.1f', cputime() - t, peak() - before);"
"""Prints CPU seconds and megabytes that the work needs above the data."""


def octave(code: str, u: FloatArray, y: FloatArray) -> list[float] | None:
    """Numbers that `code` prints of the iddata d of (N, n_u) and (N, n_y); None without Octave."""
    if shutil.which("octave") is None:
        return None
    from scipy.io import savemat

    with tempfile.TemporaryDirectory() as folder:
        data = Path(folder) / "data.mat"
        script = Path(folder) / "work.m"
        savemat(data, {"u": u.reshape(len(u), -1), "y": y.reshape(len(y), -1)})
        script.write_text(PROLOGUE.replace("{data}", str(data)) + code)
        single = {**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
        done = subprocess.run(
            ["octave", "--quiet", "--no-gui", str(script)],
            capture_output=True,
            text=True,
            check=False,
            env=single,
            cwd=folder,
        )
    try:
        return [float(word) for word in done.stdout.split()] or None
    except ValueError:
        return None
