"""From records to P: excitation, estimates, and the region in which the true P lies."""
