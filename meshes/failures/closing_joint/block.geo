// A rigid unit block on a rigid wall, a joint between them; a unit elastic cell on either side of the block.
Point(1) = {-0.5, -1, 0};
Point(2) = {0.5, -1, 0};
Point(3) = {-0.5, 0, 0};
Point(4) = {0.5, 0, 0};
Point(5) = {-0.5, 1, 0};
Point(6) = {0.5, 1, 0};
Point(7) = {-1.5, 0, 0};
Point(8) = {1.5, 0, 0};
Point(9) = {-1.5, 1, 0};
Point(10) = {1.5, 1, 0};
Line(1) = {1, 2};
Line(2) = {2, 4};
Line(3) = {1, 3};
Line(4) = {3, 4};
Line(5) = {3, 5};
Line(6) = {4, 6};
Line(7) = {5, 6};
Line(8) = {7, 3};
Line(9) = {7, 9};
Line(10) = {9, 5};
Line(11) = {4, 8};
Line(12) = {8, 10};
Line(13) = {6, 10};
Curve Loop(1) = {1, 2, -4, -3};
Curve Loop(2) = {4, 6, -7, -5};
Curve Loop(3) = {8, 5, -10, -9};
Curve Loop(4) = {11, 12, -13, -6};
For i In {1:4}
  Plane Surface(i) = {i};
EndFor
Transfinite Curve "*" = 2;
Transfinite Surface "*";
Recombine Surface "*";

Physical Surface("wall") = {1};
Physical Surface("block") = {2};
Physical Surface("spring") = {3, 4};
Physical Curve("joint") = {4};
Physical Curve("ends") = {9, 12};
Physical Curve("cut") = {7, 8, 10, 11, 13};
