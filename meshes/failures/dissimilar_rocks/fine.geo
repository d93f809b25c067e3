h = 0.5;
Include "layers.geo";
