h = 0.5;
Include "strip.geo";
