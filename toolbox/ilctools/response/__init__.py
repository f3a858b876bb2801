"""What is known of P: one object, which :mod:`.door` makes and checks once."""
