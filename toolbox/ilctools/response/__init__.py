"""What is known of P: one object, checked and made at the door, and not checked again."""
