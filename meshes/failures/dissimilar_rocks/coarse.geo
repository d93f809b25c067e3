h = 1;
Include "layers.geo";
