"""Files of Gmsh: geometries that are checked, meshes that are read, and the process that runs Gmsh."""
