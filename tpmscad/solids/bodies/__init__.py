"""Bodies: whatever bounds a volume, as a closed boundary representation that is asked once what it is."""
