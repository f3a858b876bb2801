"""Experiments on a rig: the protocol of a driver, one trial after the other, where to stop."""
