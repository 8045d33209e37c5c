"""Motion capture at the edge: the process that reads a system, and a fake one."""
