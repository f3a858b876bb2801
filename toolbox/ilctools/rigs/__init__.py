"""Experiments on a rig: the interface of its driver, the run of trials, and limits that stop it."""
