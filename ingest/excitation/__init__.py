"""What a dataset can identify: excitation, coherence, dead time."""
