h = 1;
Include "strip.geo";
