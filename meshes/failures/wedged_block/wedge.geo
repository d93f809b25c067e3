// A rigid block on a rigid wall with friction, below a rigid roof with a slope of 1:2 that a spring joint keeps off.
Point(1) = {0, -1, 0};
Point(2) = {1, -1, 0};
Point(3) = {0, 0, 0};
Point(4) = {1, 0, 0};
Point(5) = {0, 1.5, 0};
Point(6) = {1, 1, 0};
Point(7) = {0, 2.5, 0};
Point(8) = {1, 2.5, 0};
Line(1) = {1, 2};
Line(2) = {2, 4};
Line(3) = {1, 3};
Line(4) = {3, 4};
Line(5) = {3, 5};
Line(6) = {4, 6};
Line(7) = {5, 6};
Line(8) = {5, 7};
Line(9) = {6, 8};
Line(10) = {7, 8};
Curve Loop(1) = {1, 2, -4, -3};
Curve Loop(2) = {4, 6, -7, -5};
Curve Loop(3) = {7, 9, -10, -8};
For i In {1:3}
  Plane Surface(i) = {i};
EndFor
Transfinite Curve "*" = 2;
Transfinite Surface "*";
Recombine Surface "*";

Physical Surface("wall") = {1};
Physical Surface("block") = {2};
Physical Surface("roof") = {3};
Physical Curve("base") = {4};
Physical Curve("spring") = {7};
Physical Curve("cut") = {5, 6};
