"""What is known of P: one value, made at the door and asked nothing afterwards."""
