// A rigid unit block between two rigid unit walls, a joint below and one above it; a unit elastic cell on either side of it.
For i In {0:3}
  Point(2*i + 1) = {-0.5, i - 1.5, 0};
  Point(2*i + 2) = {0.5, i - 1.5, 0};
  Line(10 + i) = {2*i + 1, 2*i + 2};
EndFor
For i In {0:2}
  Line(20 + i) = {2*i + 1, 2*i + 3};  // left
  Line(30 + i) = {2*i + 2, 2*i + 4};  // right
  Curve Loop(i + 1) = {10 + i, 30 + i, -(11 + i), -(20 + i)};
  Plane Surface(i + 1) = {i + 1};
EndFor
For i In {0:1}
  x = 3*i - 1.5;
  Point(11 + 2*i) = {x, -0.5, 0};
  Point(12 + 2*i) = {x, 0.5, 0};
  Line(40 + i) = {11 + 2*i, 12 + 2*i};
  Line(50 + i) = {11 + 2*i, 3 + i};
  Line(60 + i) = {12 + 2*i, 5 + i};
  Curve Loop(4 + i) = {50 + i, 21 + 10*i, -(60 + i), -(40 + i)};
  Plane Surface(4 + i) = {4 + i};
EndFor
Transfinite Curve "*" = 2;
Transfinite Surface "*";
Recombine Surface "*";

Physical Surface("block") = {2};
Physical Surface("wall") = {1, 3};
Physical Surface("spring") = {4, 5};
Physical Curve("lower") = {11};
Physical Curve("upper") = {12};
Physical Curve("ends") = {40, 41};
