"""PX4 ULog."""
