"""Parts of pictures: units of axes, places of labels, and maps of a network."""
