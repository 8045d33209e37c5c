"""What shall be flown: the mission file, read and judged before anything flies."""
