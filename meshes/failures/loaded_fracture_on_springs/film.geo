// A film of 16 unit elements between a rigid wall below and one layer of square cells above.
n = 16;
For i In {0:2}
  Point(2*i + 1) = {0, i - 1, 0};
  Point(2*i + 2) = {n, i - 1, 0};
  Line(10 + i) = {2*i + 1, 2*i + 2};
EndFor
For i In {0:1}
  Line(20 + i) = {2*i + 1, 2*i + 3};  // left
  Line(30 + i) = {2*i + 2, 2*i + 4};  // right
  Curve Loop(i + 1) = {10 + i, 30 + i, -(11 + i), -(20 + i)};
  Plane Surface(i + 1) = {i + 1};
EndFor
Transfinite Curve {10, 11, 12} = n + 1;
Transfinite Curve {20, 21, 30, 31} = 2;
Transfinite Surface "*";
Recombine Surface "*";

Physical Surface("wall") = {1};
Physical Surface("springs") = {2};
Physical Curve("film") = {11};
Physical Curve("top") = {12};
