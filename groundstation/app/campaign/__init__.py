"""Many dry runs of one mission: what varies, who flies it, one table, what it comes to."""
