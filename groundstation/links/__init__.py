"""Ways for bytes to come and go; they know addresses and nothing of what the bytes mean."""
