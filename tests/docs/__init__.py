"""Makes the pages that are drawn from the program, the figures and the documentation site: ``make docs``."""
