// Two layers 20 x 10 of square cells of length h, a fault between them. Set h before.
length = 20; depth = 10;

For row In {0:2}
  Point(10*row + 1) = {0, (row - 1)*depth, 0};
  Point(10*row + 2) = {length, (row - 1)*depth, 0};
  Line(100 + row) = {10*row + 1, 10*row + 2};
EndFor
For row In {0:1}
  Line(200 + row) = {10*row + 1, 10*row + 11};
  Line(300 + row) = {10*row + 2, 10*row + 12};
  Curve Loop(row + 1) = {100 + row, 300 + row, -(101 + row), -(200 + row)};
  Plane Surface(row + 1) = {row + 1};
EndFor
Transfinite Curve {100:102} = Round(length/h) + 1;
Transfinite Curve {200, 201, 300, 301} = Round(depth/h) + 1;
Transfinite Surface "*";
Recombine Surface "*";

Physical Surface("fast") = {1};
Physical Surface("slow") = {2};
Physical Curve("fault") = {101};
Physical Curve("south") = {100};
Physical Curve("north") = {102};
Physical Curve("west") = {200, 201};
Physical Curve("east") = {300, 301};
