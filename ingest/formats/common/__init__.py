"""What several formats share: bytes at many places, Arrow from buffers, losses counted, vehicle time."""
