"""The command ``gem view``: runs in the browser, from this machine alone."""
