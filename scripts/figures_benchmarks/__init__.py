"""Public problems run by one command: their table, a picture each, and error against CPU over all of them."""
