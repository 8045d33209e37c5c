"""What the team is doing, phase by phase."""
