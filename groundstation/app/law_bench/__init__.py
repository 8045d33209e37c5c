"""Races of the product's law against others, on the emulator's physics and with the same starts and noise."""
