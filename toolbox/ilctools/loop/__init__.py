"""The loops to which learning is applied: designed here, or closed by another controller."""
