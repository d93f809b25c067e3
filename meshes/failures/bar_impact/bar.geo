// A bar of 40 square cells, length 1, and the wall on its left that it hits.
n = 40; h = 1/n;

Point(1) = {-h, 0, 0};
Point(2) = {0, 0, 0};
Point(3) = {1, 0, 0};
Point(4) = {-h, h, 0};
Point(5) = {0, h, 0};
Point(6) = {1, h, 0};
Line(1) = {1, 2};
Line(2) = {2, 3};
Line(3) = {4, 5};
Line(4) = {5, 6};
Line(5) = {1, 4};
Line(6) = {2, 5};
Line(7) = {3, 6};
Curve Loop(1) = {1, 6, -3, -5};
Curve Loop(2) = {2, 7, -4, -6};
Plane Surface(1) = {1};
Plane Surface(2) = {2};
Transfinite Curve {1, 3, 5, 6, 7} = 2;
Transfinite Curve {2, 4} = n + 1;
Transfinite Surface "*";
Recombine Surface "*";

Physical Surface("wall") = {1};
Physical Surface("bar") = {2};
Physical Curve("face") = {6};
