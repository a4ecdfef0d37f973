"""A whole vehicle for simulators and controllers."""
