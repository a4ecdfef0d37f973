"""Fitted models for other programs: C99, FMU, MATLAB text, CasADi, JAX, ONNX."""

from flysid.export.programs import program_of
from flysid.export.reference import run

__all__ = ["program_of", "run"]
