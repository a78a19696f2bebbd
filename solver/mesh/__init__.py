"""Bodies: structured and Gmsh meshes, their checks and quality."""
