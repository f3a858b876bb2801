"""Trials under a law: simulate them, transfer them to another task, and diagnose them."""
