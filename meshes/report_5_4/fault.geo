// A fault along y at x = 0 with 4 joints of length 1000 ft, and two columns of quads a side.
joints = 4;
length = 1000;
width = 1000; // of a column
y0 = -2000;   // start of the fault

For i In {0:4}
  Point(2*i + 1) = {(i - 2)*width, y0, 0};
  Point(2*i + 2) = {(i - 2)*width, y0 + joints*length, 0};
  Line(10 + i) = {2*i + 1, 2*i + 2};
EndFor
For i In {0:3}
  Line(20 + i) = {2*i + 1, 2*i + 3};  // south
  Line(30 + i) = {2*i + 2, 2*i + 4};  // north
  Curve Loop(i + 1) = {20 + i, 11 + i, -(30 + i), -(10 + i)};
  Plane Surface(i + 1) = {i + 1};
EndFor
Transfinite Curve {10:14} = joints + 1;
Transfinite Curve {20:23, 30:33} = 2;
Transfinite Surface "*";
Recombine Surface "*";

Physical Surface("rock") = {1:4};
Physical Curve("fault") = {12};
Physical Curve("west") = {10};
Physical Curve("east") = {14};
Physical Curve("south") = {20:23};
Physical Curve("north") = {30:33};
// Ends of the rock between the fault and the outer faces.
Physical Point("south-west") = {3};
Physical Point("north-west") = {4};
Physical Point("south-east") = {7};
Physical Point("north-east") = {8};
