"""What every key of the files that people write means; from it editors' schemas and the reference pages are made."""
