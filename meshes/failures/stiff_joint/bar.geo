// Two bars of n square cells each along x, a joint of one facet between them at x = 0; ends "west" and "east".
n = 20;
h = 1;

For i In {0:2}
  Point(2*i + 1) = {(i - 1)*n*h, 0, 0};
  Point(2*i + 2) = {(i - 1)*n*h, h, 0};
  Line(10 + i) = {2*i + 1, 2*i + 2};
EndFor
For i In {0:1}
  Line(20 + i) = {2*i + 1, 2*i + 3};
  Line(30 + i) = {2*i + 2, 2*i + 4};
  Curve Loop(i + 1) = {20 + i, 11 + i, -(30 + i), -(10 + i)};
  Plane Surface(i + 1) = {i + 1};
EndFor
Transfinite Curve {10:12} = 2;
Transfinite Curve {20, 21, 30, 31} = n + 1;
Transfinite Surface "*";
Recombine Surface "*";

Physical Surface("rock") = {1, 2};
Physical Curve("joint") = {11};
Physical Curve("west") = {10};
Physical Curve("east") = {12};
Physical Curve("south") = {20, 21};
Physical Curve("north") = {30, 31};
