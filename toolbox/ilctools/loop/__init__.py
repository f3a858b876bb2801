"""The loops to which learning is applied: the loop of the paper, and other controllers' loops."""
