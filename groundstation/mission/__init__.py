"""A mission: what shall be flown (plan), and the object that flies it (runner): bytes and times in, bytes out."""
