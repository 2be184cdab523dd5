"""Files of episodes as a person reads them: an index, filters, pages for the terminal, a diff, and one HTML page."""
