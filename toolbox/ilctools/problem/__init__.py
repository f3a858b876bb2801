"""What is asked of the learning filter: one checked object, and how it is stated."""
