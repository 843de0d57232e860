"""Skins: the part of a body that is deeper than a skin, and the body without what matter leaves of that part."""
