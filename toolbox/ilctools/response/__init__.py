"""Frequency responses of plants in one object, which :mod:`.door` makes and checks once."""
