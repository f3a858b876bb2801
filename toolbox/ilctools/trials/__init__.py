"""Trials under the law: simulated, carried to another task, diagnosed from their signals."""
