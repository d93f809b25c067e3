// A thin layer of rock, 11 long, on a rigid bed; a pushed or pulled piece of its top around each of 12 places 1 apart.
n = 12;
h = 0.25;
For i In {0:n-1}
  Point(1 + i) = {i, -1, 0};
  Point(101 + i) = {i, 0, 0};
  Point(201 + i) = {i, h, 0};
EndFor
For i In {0:n-2}
  Line(1 + i) = {1 + i, 2 + i};
  Line(101 + i) = {101 + i, 102 + i};
  Line(201 + i) = {201 + i, 202 + i};
EndFor
For i In {0:n-1}
  Line(301 + i) = {1 + i, 101 + i};
  Line(401 + i) = {101 + i, 201 + i};
EndFor
For i In {0:n-2}
  Curve Loop(1 + i) = {1 + i, 302 + i, -(101 + i), -(301 + i)};
  Plane Surface(1 + i) = {1 + i};
  Curve Loop(101 + i) = {101 + i, 402 + i, -(201 + i), -(401 + i)};
  Plane Surface(101 + i) = {101 + i};
EndFor
Transfinite Curve "*" = 2;
Transfinite Surface "*";
Recombine Surface "*";

Physical Surface("bed") = {1:n-1};
Physical Surface("layer") = {101:100+n-1};
Physical Curve("bedding") = {101:100+n-1};
Physical Curve("end") = {401};
For i In {0:n-2}
  Physical Curve(Sprintf("top%g", i)) = {201 + i};
EndFor
