"""What is done in the air: where everybody is, guidance, formation flight, climbing, landing, killing."""
