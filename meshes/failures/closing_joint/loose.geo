// The same without the elastic cells: nothing but the joint holds the block.
Point(1) = {-0.5, -1, 0};
Point(2) = {0.5, -1, 0};
Point(3) = {-0.5, 0, 0};
Point(4) = {0.5, 0, 0};
Point(5) = {-0.5, 1, 0};
Point(6) = {0.5, 1, 0};
Line(1) = {1, 2};
Line(2) = {2, 4};
Line(3) = {1, 3};
Line(4) = {3, 4};
Line(5) = {3, 5};
Line(6) = {4, 6};
Line(7) = {5, 6};
Curve Loop(1) = {1, 2, -4, -3};
Curve Loop(2) = {4, 6, -7, -5};
Plane Surface(1) = {1};
Plane Surface(2) = {2};
Transfinite Curve "*" = 2;
Transfinite Surface "*";
Recombine Surface "*";

Physical Surface("wall") = {1};
Physical Surface("block") = {2};
Physical Curve("joint") = {4};
Physical Curve("cut") = {7};
