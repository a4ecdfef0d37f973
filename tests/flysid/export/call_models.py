"""Run by a Python that has CasADi, JAX or onnxruntime: calls every exported model of a folder.

    python call_models.py casadi|jax|onnx FOLDER

NAME.npz holds `u` (2, N, n_u) and `weights` (H, n_y). NAME.KIND.npz becomes what the model answered: `y`
(2, N, n_y), from rest, then from the `memory` that the first run left; and from that memory on the gradients
of sum(weights * y) over H rows by inputs and memory, `by_u` and `by_x`. `go_on` (N - W, n_y) is a run from
the memory after `measured` (W, n_y) outputs, along the inputs behind these. It knows nothing of flysid.
"""

from __future__ import annotations

import importlib
import json
import os
import sys
from pathlib import Path
from typing import Any

import numpy as np


def of_casadi(name: str, u: Any, weights: Any, measured: Any) -> dict[str, Any]:
    import casadi as ca

    model = importlib.import_module(f"{name}_casadi")
    assert model.step.name_in() == ["x", "u"]
    assert model.step.name_out() == ["x_next", "y"]
    first, memory = model.simulate(u[0].T)
    second, _ = model.simulate(u[1].T, memory)
    window = ca.MX.sym("u", u.shape[2], len(weights))
    start = ca.MX.sym("x", model.REST.shape[0])
    cost = ca.dot(model.simulate(window, start)[0], weights.T)
    slopes = [ca.gradient(cost, start), ca.gradient(cost, window)]
    gradients = ca.Function("gradients", [start, window], slopes)
    seen = len(measured)
    go_on, _ = model.simulate(u[0, seen:].T, model.start(u[0, :seen].T, measured.T))
    by_x, by_u = gradients(memory, u[1, : len(weights)].T)
    return {
        "y": np.stack([np.array(first).T, np.array(second).T]),
        "go_on": np.array(go_on).T,
        "memory": np.array(memory).ravel(),
        "by_x": np.array(by_x).ravel(),
        "by_u": np.array(by_u).T,
    }


def of_jax(name: str, u: Any, weights: Any, measured: Any) -> dict[str, Any]:
    import jax

    model = importlib.import_module(f"{name}_jax")
    simulate = jax.jit(model.simulate)
    first, memory = simulate(u[0], model.REST)
    assert first.dtype == np.float64
    second, _ = simulate(u[1], memory)
    window = u[1, : len(weights)]
    cost = jax.jit(jax.grad(lambda x, inputs: (model.simulate(inputs, x)[0] * weights).sum(), (0, 1)))
    by_x, by_u = cost(memory, window)
    seen = len(measured)
    go_on, _ = model.simulate(u[0, seen:], model.start(u[0, :seen], measured))
    return {"y": np.stack([first, second]), "go_on": go_on, "memory": memory, "by_x": by_x, "by_u": by_u}


def of_onnx(name: str, u: Any, _weights: Any, _measured: Any) -> dict[str, Any]:
    """Step by step, both runs as one batch: from rest, and from rest with the inputs of the second."""
    import onnxruntime

    names = json.loads(Path(f"{name}.json").read_text("utf-8"))
    session = onnxruntime.InferenceSession(f"{name}.onnx", providers=["CPUExecutionProvider"])
    has_memory = bool(names["x"])
    assert [i.name for i in session.get_inputs()] == (["x", "u"] if has_memory else ["u"])
    assert [o.name for o in session.get_outputs()] == (["x_next", "y"] if has_memory else ["y"])
    memory = np.array([[entry["rest"] for entry in names["x"]]] * 2, dtype=np.float32)
    rows = []
    for now in u.transpose(1, 0, 2).astype(np.float32):
        if has_memory:
            memory, y = session.run(None, {"x": memory, "u": now})
        else:
            (y,) = session.run(None, {"u": now})
        rows.append(y)
    scale = np.array([entry["scale"] for entry in names["x"]])
    shift = np.array([entry["shift"] for entry in names["x"]])
    return {"y": np.stack(rows, axis=1), "memory": memory * scale + shift}


KINDS = {"casadi": of_casadi, "jax": of_jax, "onnx": of_onnx}


def main(kind: str, folder: Path) -> None:
    sys.path.insert(0, str(folder))
    os.chdir(folder)
    for path in sorted(folder.glob("*.npz")):
        with np.load(path) as given:
            found = KINDS[kind](path.stem, given["u"], given["weights"], given["measured"])
        np.savez(folder / f"{path.stem}.{kind}", **found)


if __name__ == "__main__":
    main(sys.argv[1], Path(sys.argv[2]))
