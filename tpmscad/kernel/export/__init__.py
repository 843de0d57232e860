"""Files other than STEP: closed triangle meshes as STL, 3MF and glTF, and the kernel's own BREP format."""
