"""What moves: motor, handle, hand, cogging and encoder, and the truth about them."""
