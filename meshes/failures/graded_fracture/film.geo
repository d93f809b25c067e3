// A film of six elements of very unequal length between a rigid wall below and one layer of cells above.
x[] = {0, 0.6, 1.07, 2.95, 4.1, 4.74, 6.86};
n = #x[];
For row In {0:2}
  For i In {0:n-1}
    Point(row*n + i + 1) = {x[i], row - 1, 0};
  EndFor
  For i In {1:n-1}
    Line(100*row + i) = {row*n + i, row*n + i + 1};
  EndFor
EndFor
For row In {0:1}
  For i In {1:n}
    Line(1000 + 100*row + i) = {row*n + i, (row + 1)*n + i};
  EndFor
  For i In {1:n-1}
    Curve Loop(100*row + i) = {100*row + i, 1001 + 100*row + i, -(100*row + 100 + i), -(1000 + 100*row + i)};
    Plane Surface(100*row + i) = {100*row + i};
  EndFor
EndFor
Transfinite Curve "*" = 2;
Transfinite Surface "*";
Recombine Surface "*";

Physical Surface("wall") = {1:n-1};
Physical Surface("springs") = {101:100+n-1};
Physical Curve("film") = {101:100+n-1};
Physical Curve("top") = {201:200+n-1};
