"""What each method pays for accuracy: error against CPU seconds and counted work, on problems with a known answer."""
