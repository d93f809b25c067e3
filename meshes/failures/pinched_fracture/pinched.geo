// A fixed base and three blocks on it, apart from it by a slot and from each other by two cuts.
Point(1) = {0, -1, 0}; Point(2) = {3, -1, 0};
For i In {0:3}
  Point(10 + i) = {i, 0, 0}; Point(20 + i) = {i, 1, 0};
EndFor
Line(1) = {1, 2}; Line(2) = {2, 13}; Line(3) = {10, 1};
For i In {0:2}
  Line(10 + i) = {10 + i, 11 + i}; Line(20 + i) = {20 + i, 21 + i};
EndFor
For i In {0:3}
  Line(30 + i) = {10 + i, 20 + i};
EndFor
Curve Loop(1) = {1, 2, -12, -11, -10, 3}; Plane Surface(1) = {1};
For i In {0:2}
  Curve Loop(10 + i) = {10 + i, 31 + i, -(20 + i), -(30 + i)}; Plane Surface(10 + i) = {10 + i};
EndFor
Mesh.MeshSizeMin = 0.5; Mesh.MeshSizeMax = 0.5;
Physical Surface("base") = {1}; Physical Surface("left") = {10}; Physical Surface("middle") = {11}; Physical Surface("right") = {12};
Physical Curve("slot") = {10, 11, 12}; Physical Curve("cut") = {31, 32}; Physical Curve("press") = {21};
