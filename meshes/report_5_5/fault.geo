// A fault along y at x = 0 with 6 joints of length 1000 ft, and two columns of quads a side.
joints = 6;
columns = 2;
length = 1000;
width = 2000;
y0 = -3000;  // start of the fault

For i In {0:2}
  Point(2*i + 1) = {(i - 1)*width, y0, 0};
  Point(2*i + 2) = {(i - 1)*width, y0 + joints*length, 0};
  Line(10 + i) = {2*i + 1, 2*i + 2};
EndFor
For i In {0:1}
  Line(20 + i) = {2*i + 1, 2*i + 3};  // south
  Line(30 + i) = {2*i + 2, 2*i + 4};  // north
  Curve Loop(i + 1) = {20 + i, 11 + i, -(30 + i), -(10 + i)};
  Plane Surface(i + 1) = {i + 1};
EndFor
Transfinite Curve {10:12} = joints + 1;
Transfinite Curve {20, 21, 30, 31} = columns + 1;
Transfinite Surface "*";
Recombine Surface "*";

Physical Surface("rock") = {1, 2};
Physical Curve("fault") = {11};
Physical Curve("west") = {10};
Physical Curve("east") = {12};
Physical Curve("south") = {20, 21};
Physical Curve("north") = {30, 31};
