h = 0.25;
Include "strip.geo";
