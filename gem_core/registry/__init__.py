"""What there is to make: the records that plugins hand over, how plugins are loaded, and how an id is looked up."""
