"""The design problem of the learning filter, made from the user's arguments and checked."""
