"""What a flight can identify: excitation, coherence, dead time, doubts."""
