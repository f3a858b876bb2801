"""The law (23): one step from trial to trial, within what actuators follow, and its notes."""
