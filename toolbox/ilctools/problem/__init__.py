"""The design problem of the learning filter: one checked object, and how a user states it."""
