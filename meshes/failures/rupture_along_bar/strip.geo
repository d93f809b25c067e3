// A strip 24 x 0.01 of square-ended cells of length h on a rigid base; sides "patch" and "rest" on top. Set h before.
length = 24; patch = 4; depth = 0.01;

Point(1) = {0, 0, 0};
Point(2) = {patch, 0, 0};
Point(3) = {length, 0, 0};
For i In {1:3}
  x = (i == 1) ? 0 : ((i == 2) ? patch : length);
  Point(10 + i) = {x, depth, 0};
  Point(20 + i) = {x, -depth, 0};
EndFor
For row In {0:2}
  Line(100 + row) = {10*row + 1, 10*row + 2};
  Line(110 + row) = {10*row + 2, 10*row + 3};
EndFor
For i In {1:3}
  Line(200 + i) = {i, 10 + i};
  Line(300 + i) = {20 + i, i};
EndFor
Curve Loop(1) = {100, 202, -101, -201};
Curve Loop(2) = {110, 203, -111, -202};
Curve Loop(3) = {102, 302, -100, -301};
Curve Loop(4) = {112, 303, -110, -302};
Plane Surface(1) = {1};
Plane Surface(2) = {2};
Plane Surface(3) = {3};
Plane Surface(4) = {4};
Transfinite Curve {100, 101, 102} = Round(patch/h) + 1;
Transfinite Curve {110, 111, 112} = Round((length - patch)/h) + 1;
Transfinite Curve {201:203, 301:303} = 2;
Transfinite Surface "*";
Recombine Surface "*";

Physical Surface("bar") = {1, 2};
Physical Surface("base") = {3, 4};
Physical Curve("bed") = {100, 110};
Physical Curve("patch") = {101};
Physical Curve("rest") = {111};
Physical Curve("end") = {203};
