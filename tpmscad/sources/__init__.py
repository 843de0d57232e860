"""Where the surfaces of a lattice come from: exact patches, mirrored pieces, level sets; chosen once for each surface."""
