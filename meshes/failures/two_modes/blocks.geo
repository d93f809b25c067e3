// Two unit blocks between two unit walls, a joint under each and one above; a short piece of each left side lets waves out.
vent[] = {0, 0.01, 0.02, 0};
For i In {0:4}
  Point(2*i + 1) = {0, i - 1, 0};
  Point(2*i + 2) = {1, i - 1, 0};
  Line(10 + i) = {2*i + 1, 2*i + 2};
EndFor
For i In {0:3}
  Line(30 + i) = {2*i + 2, 2*i + 4};  // right
EndFor
For i In {1:2}
  Point(40 + i) = {0, i - 0.5 - vent[i]/2, 0};
  Point(50 + i) = {0, i - 0.5 + vent[i]/2, 0};
  Line(60 + i) = {2*i + 1, 40 + i};
  Line(70 + i) = {40 + i, 50 + i};    // the vent
  Line(80 + i) = {50 + i, 2*i + 3};
  Curve Loop(i + 1) = {10 + i, 30 + i, -(11 + i), -(80 + i), -(70 + i), -(60 + i)};
  Plane Surface(i + 1) = {i + 1};
EndFor
Line(20) = {1, 3};
Line(23) = {7, 9};
Curve Loop(1) = {10, 30, -11, -20};
Plane Surface(1) = {1};
Curve Loop(4) = {13, 33, -14, -23};
Plane Surface(4) = {4};
Transfinite Curve "*" = 2;

Physical Surface("slider") = {2};
Physical Surface("mass") = {3};
Physical Surface("wall") = {1, 4};
Physical Curve("fault") = {11};
Physical Curve("between") = {12};
Physical Curve("above") = {13};
Physical Curve("free") = {61, 62, 81, 82, 31, 32};
Physical Curve("vents") = {71, 72};
