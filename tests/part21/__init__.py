"""A reader of STEP Part 21 files and the rules of the application protocols, independent of the writer."""
