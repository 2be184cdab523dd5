"""Studies: the paper's claims, shown by many small runs on the processors of one machine."""
